"""Writes to widgets only what differs: each assignment is sent to every browser."""

from __future__ import annotations

from typing import Any


def write(widget: Any, **values: Any) -> None:
    """Assign ``values`` (value, content, disabled, visible ...) to a widget where they differ."""
    for name, value in values.items():
        if getattr(widget, name) != value:
            setattr(widget, name, value)
