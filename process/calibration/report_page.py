"""The report of a calibration: one HTML page with its pictures in it, readable without a network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError
from process.calibration.camera.calibrate import CameraResult
from process.calibration.light_plane.compare import PlaneDifference
from process.calibration.light_plane.from_sweeps import PlaneResult
from process.calibration.light_plane.plane_residuals import LIMIT_UM
from process.calibration.quarter_circle.calibrate import QuarterCircle
from process.html_templates import png_url, render

MAGNIFIED = 10.0
TRACK_LIMIT_UM = 2.0
CELLS_ACROSS = 24
FEWEST_IN_CELL = 3
CELL_PX = 12
"""Side of the cells that a residual map shows: a board's clear pixels are islands, too small to see alone."""
F8 = NDArray[np.float64]
_TEMPLATE = Path(__file__).with_name("report_page.html")
_DPI = 110


def camera_page(result: CameraResult, words: Sequence[str]) -> str:
    """Coverage, residual vectors magnified ten times, error per view, and the verdict in words."""
    verdict = f"{len(result.used)} of {len(result.views)} views agree within {result.fit.rms_px:.3f} px"
    if result.stage is not None:
        verdict += (
            f"; points at the corners of the field are known to {result.predicted_um[0]:.2g} um on the board's plane, "
            f"{result.predicted_um[1]:.2g} um half a millimetre above (standard deviations, camera only)"
        )
    return _page("Camera calibration", verdict, words, [_coverage(result), _per_view(result)], good=not result.notes)


def plane_page(result: PlaneResult, words: Sequence[str]) -> str:
    """Residual map of each surface, and the verdict in words."""
    verdict = (
        f"all {len(result.surfaces)} surfaces agree within {LIMIT_UM:g} um; the normal is known to "
        f"{result.normal_sd_deg:.3f} degrees, the speed to {100 * result.speed_sd:.3f} %"
        if result.ok
        else "FAILED: " + "; ".join(f"{s.name}: {s.cause}" for s in result.surfaces if not s.ok)
    )
    return _page("Light plane calibration", verdict, words, [_maps(result)], good=result.ok)


def quarter_circle_page(result: QuarterCircle, words: Sequence[str], between: PlaneDifference | None) -> str:
    """The corner's track with its residuals, the lengths of both edges, and how another light plane differs."""
    figures = [] if not result.patterns else [_track(result)]
    if between is not None:
        figures.append(_differences(between))
    good = not result.patterns or result.track_rms_um < TRACK_LIMIT_UM
    verdict = "the corner moves straight" if good else "the corner's track scatters: an uneven flat, or a loose stage"
    return _page("Light plane from the quarter circle", verdict, words, figures, good=good)


def write_page(path: Path, page: str) -> None:
    """Write a report.

    Raises:
        CalibrationError: it cannot be written.
    """
    try:
        path.write_text(page, encoding="utf-8", errors="backslashreplace")  # names of pictures may be any bytes
    except OSError as error:
        raise CalibrationError(f"cannot write the report {path}: {error.strerror}; the calibration is safe") from None


def _page(title: str, verdict: str, words: Sequence[str], figures: Sequence[Figure], *, good: bool) -> str:
    pictures = [png_url(figure, _DPI) for figure in figures]
    return render(_TEMPLATE, title=title, verdict=verdict, lines=words, pictures=pictures, good=good)


def _coverage(result: CameraResult) -> Figure:
    """Where corners were seen and by how much each is off, magnified; beside it the mean per part of the field."""
    figure = Figure(figsize=(12, 5), layout="constrained")
    left, right = figure.subplots(1, 2)
    places = np.concatenate([view.pixels for view in result.used])
    errors = np.concatenate([-result.fit.residuals(index, view) for index, view in enumerate(result.used)])
    for index, view in enumerate(result.used):
        off = -result.fit.residuals(index, view)
        left.plot(*view.pixels.T, ".", markersize=2, alpha=0.4)
        left.quiver(
            *view.pixels.T, *(MAGNIFIED * off).T, angles="xy", scale_units="xy", scale=1, width=0.0015, alpha=0.7
        )
    left.set_title(f"corners of all views, residuals x {MAGNIFIED:.0f}; {100 * result.coverage:.0f} % of the field")
    cell = result.size[0] / CELLS_ACROSS
    rows = int(np.ceil(result.size[1] / cell))
    number = (places[:, 1] // cell).astype(int).clip(0, rows - 1) * CELLS_ACROSS
    number += (places[:, 0] // cell).astype(int).clip(0, CELLS_ACROSS - 1)
    count = np.bincount(number, minlength=rows * CELLS_ACROSS)
    mean = [np.bincount(number, part, rows * CELLS_ACROSS) / np.maximum(count, 1) for part in errors.T]
    extent = (0, CELLS_ACROSS * cell, rows * cell, 0)
    image = right.imshow(count.reshape(rows, -1), extent=extent, cmap="Blues", vmin=0, aspect="auto")
    figure.colorbar(image, ax=right, label="corners")
    seen = np.flatnonzero(count >= FEWEST_IN_CELL)
    longest = max(float(np.hypot(mean[0][seen], mean[1][seen]).max()) if len(seen) else 0.0, 1e-6)
    scale = longest / cell
    middle = (np.column_stack([seen % CELLS_ACROSS, seen // CELLS_ACROSS]) + 0.5) * cell
    right.quiver(
        *middle.T,
        mean[0][seen],
        mean[1][seen],
        angles="xy",
        scale_units="xy",
        scale=scale,
        width=0.004,
        color="#b00020",
    )
    right.set_title(f"corners in each part, and their mean residual (longest {longest:.3f} px)")
    for axes in (left, right):
        axes.set(xlim=(0, result.size[0]), ylim=(result.size[1], 0), xlabel="px", ylabel="px", aspect="equal")
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
    """Residual of each surface in cells of the picture, and how it is spread."""
    rows = len(result.surfaces)
    figure = Figure(figsize=(12, 4 * rows), layout="constrained")
    grid: Any = figure.subplots(rows, 2, squeeze=False, width_ratios=(2, 1))
    for (left, right), surface in zip(grid, result.surfaces, strict=True):
        limit = max(3 * surface.rms_um, 0.5)
        cells = _in_cells(surface.map_um)
        height, width = surface.map_um.shape
        image = left.imshow(
            cells, vmin=-limit, vmax=limit, cmap="RdBu", interpolation="nearest", extent=(0, width, height, 0)
        )
        left.set_facecolor("#e0e0e0")
        left.set(title=f"{surface.name}: residual, mean {surface.mean_um:+.2f} um, RMS {surface.rms_um:.2f} um",
                 xlabel="px", ylabel="px")  # fmt: skip
        figure.colorbar(image, ax=left, label="um along the light plane's normal")
        values = surface.map_um[np.isfinite(surface.map_um)]
        right.hist(values, bins=80, range=(-2 * limit, 2 * limit))
        right.axvspan(-LIMIT_UM, LIMIT_UM, alpha=0.12, color="green")
        right.set(title="pixels; green: where the mean has to lie", xlabel="um", yticks=[])
    return figure


def _in_cells(values: F8) -> F8:
    """Means over cells of CELL_PX pixels, NaN where a cell has none."""
    height, width = values.shape
    padded = np.full((-(-height // CELL_PX) * CELL_PX, -(-width // CELL_PX) * CELL_PX), np.nan)
    padded[:height, :width] = values
    parts = padded.reshape(padded.shape[0] // CELL_PX, CELL_PX, padded.shape[1] // CELL_PX, CELL_PX)
    known = np.isfinite(parts)
    total, count = np.where(known, parts, 0.0).sum(axis=(1, 3)), known.sum(axis=(1, 3))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _track(result: QuarterCircle) -> Figure:
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    t = np.array([seen.t for seen in result.patterns])
    corners = np.array([seen.corner for seen in result.patterns])
    off = 1000 * (corners - (result.origin + t[:, None] * result.velocity)[:, :2])
    for axis, name in enumerate("xy"):
        above.plot(t, off[:, axis], ".", markersize=3, label=name)
    above.set(ylabel="um", title="corner: off its straight track")
    above.legend()
    for name, label in (("lead_end", "leading edge"), ("side_end", "the other edge")):
        seen = [s for s in result.patterns if getattr(s, name) is not None]
        length = np.array([np.linalg.norm(getattr(s, name) - s.corner) for s in seen])
        below.plot([s.t for s in seen], 1000 * (length - np.median(length)), ".", markersize=3, label=label)
    below.set(xlabel=result.parameter, ylabel="um", title="lengths of the straight edges: off their median")
    below.legend()
    return figure


def _differences(between: PlaneDifference) -> Figure:
    figure = Figure(figsize=(9, 3), layout="constrained")
    grid: Any = figure.subplots(1, len(between.heights_mm))
    limit = max(float(np.abs(between.along_ray_um).max()), 0.5)
    for axes, height, table in zip(grid, between.heights_mm, between.along_ray_um, strict=True):
        image = axes.imshow(table, vmin=-limit, vmax=limit, cmap="RdBu")
        axes.set(title=f"z = {height:g} mm", xticks=[], yticks=[])
    figure.colorbar(image, ax=list(grid), label="um nearer")
    figure.suptitle("by how much points differ from those of the other light plane, over the picture")
    return figure
