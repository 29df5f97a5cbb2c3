"""Owns the report of a calibration: one HTML page with its pictures in it, readable without a network."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from acquire.contract.errors import CalibrationError

from .camera import CameraResult
from .comparing import Difference
from .plane_sweep import PlaneResult
from .quarter_circle import QuarterCircle

MAGNIFIED = 10.0
TRACK_LIMIT_UM = 2.0
_STYLE = "body{font:15px/1.5 sans-serif;max-width:60em;margin:2em auto}img{max-width:100%}.bad{color:#b00020}"


def camera_page(result: CameraResult, words: Sequence[str]) -> str:
    """Coverage, residual vectors magnified ten times, error per view, and the verdict in words."""
    verdict = f"{len(result.used)} views agree within {result.fit.rms_px:.3f} px"
    return _page("Camera calibration", verdict, words, [_coverage(result), _per_view(result)], good=not result.notes)


def plane_page(result: PlaneResult, words: Sequence[str]) -> str:
    """Residual map of each surface, and the verdict in words."""
    verdict = "all surfaces agree within 1 um" if result.ok else "FAILED: the surfaces contradict each other"
    return _page("Light plane calibration", verdict, words, [_maps(result)], good=result.ok)


def quarter_circle_page(result: QuarterCircle, words: Sequence[str], between: Difference | None) -> str:
    """The corner's track with its residuals, the lengths of both edges, and how another light plane differs."""
    figures = [] if not result.seen else [_track(result)]
    if between is not None:
        figures.append(_differences(between))
    good = not result.seen or result.track_rms_um < TRACK_LIMIT_UM
    verdict = "the corner moves straight" if good else "the corner's track scatters: an uneven flat, or a loose stage"
    return _page("Light plane from the quarter circle", verdict, words, figures, good=good)


def write_page(path: Path, page: str) -> None:
    """Write a report.

    Raises:
        CalibrationError: it cannot be written.
    """
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise CalibrationError(f"cannot write the report {path}: {error.strerror}; the calibration is safe") from None


def _page(title: str, verdict: str, words: Sequence[str], figures: Sequence[Figure], *, good: bool) -> str:
    lines = "".join(f"<li>{html.escape(line)}</li>" for line in words)
    images = "".join(f'<p><img alt="" src="data:image/png;base64,{_png(figure)}"></p>' for figure in figures)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title><style>{_STYLE}</style>'
        f'<h1>{title}</h1><p class="{"good" if good else "bad"}"><b>{html.escape(verdict)}</b></p>'
        f"<ul>{lines}</ul>{images}</html>\n"
    )


def _png(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def _coverage(result: CameraResult) -> Figure:
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    axes: Any = figure.subplots()
    for index, view in enumerate(result.used):
        error = -result.fit.residuals(index, view)
        axes.plot(*view.pixels.T, ".", markersize=2, alpha=0.5)
        axes.quiver(
            *view.pixels.T, *(MAGNIFIED * error).T, angles="xy", scale_units="xy", scale=1, width=0.0012, alpha=0.6
        )
    axes.set(xlim=(0, result.size[0]), ylim=(result.size[1], 0), xlabel="px", ylabel="px", aspect="equal")
    axes.set_title(f"corners of all views, residuals x {MAGNIFIED:.0f}; {100 * result.coverage:.0f} % of the field")
    return figure


def _per_view(result: CameraResult) -> Figure:
    figure = Figure(figsize=(9, 3), layout="constrained")
    axes: Any = figure.subplots()
    shown = [view for view in result.views if not view.reason]
    axes.bar(np.arange(len(shown)), [view.rms_px for view in shown])
    axes.set_xticks(np.arange(len(shown)), [view.name for view in shown], rotation=60, ha="right")
    axes.set(ylabel="RMS, px", title="reprojection error per view")
    return figure


def _maps(result: PlaneResult) -> Figure:
    figure = Figure(figsize=(9, 4.2 * len(result.surfaces)), layout="constrained")
    grid: Any = figure.subplots(len(result.surfaces), 1, squeeze=False)
    for axes, surface in zip(grid[:, 0], result.surfaces, strict=True):
        limit = max(3 * surface.rms_um, 0.5)
        image = axes.imshow(surface.map_um, vmin=-limit, vmax=limit, cmap="RdBu", interpolation="nearest")
        axes.set_title(f"{surface.name}: residual, mean {surface.mean_um:+.2f} um, RMS {surface.rms_um:.2f} um")
        figure.colorbar(image, ax=axes, label="um")
    return figure


def _track(result: QuarterCircle) -> Figure:
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    t = np.array([seen.t for seen in result.seen])
    corners = np.array([seen.corner for seen in result.seen])
    off = 1000 * (corners - (result.origin + t[:, None] * result.velocity)[:, :2])
    for axis, name in enumerate("xy"):
        above.plot(t, off[:, axis], ".", markersize=3, label=name)
    above.set(ylabel="um", title="corner: off its straight track")
    above.legend()
    for name, label in (("lead_end", "leading edge"), ("side_end", "the other edge")):
        seen = [s for s in result.seen if getattr(s, name) is not None]
        length = np.array([np.linalg.norm(getattr(s, name) - s.corner) for s in seen])
        below.plot([s.t for s in seen], 1000 * (length - np.median(length)), ".", markersize=3, label=label)
    below.set(xlabel=result.parameter, ylabel="um", title="lengths of the straight edges: off their median")
    below.legend()
    return figure


def _differences(between: Difference) -> Figure:
    figure = Figure(figsize=(9, 3), layout="constrained")
    grid: Any = figure.subplots(1, len(between.heights_mm))
    limit = max(float(np.abs(between.along_ray_um).max()), 0.5)
    for axes, height, table in zip(grid, between.heights_mm, between.along_ray_um, strict=True):
        image = axes.imshow(table, vmin=-limit, vmax=limit, cmap="RdBu")
        axes.set(title=f"z = {height:g} mm", xticks=[], yticks=[])
    figure.colorbar(image, ax=list(grid), label="um nearer")
    figure.suptitle("by how much points differ from those of the other light plane, over the picture")
    return figure
