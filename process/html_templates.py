"""HTML from templates: each lies beside the module that renders it, and every value put into it is escaped."""

from __future__ import annotations

import base64
import io
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2

if TYPE_CHECKING:
    from matplotlib.figure import Figure  # takes half a second


def render(template: Path, **values: Any) -> str:
    """The template with ``values`` put in; a value that is missing raises, a string from a template is not escaped."""
    return _load(template).render(values)


@cache
def _load(path: Path) -> jinja2.Template:
    loader = jinja2.FileSystemLoader(path.parent)
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template(path.name)


def png_url(figure: Figure, dpi: int) -> str:
    """A figure as the address of an image that is in the page itself."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
