"""Residuals of sweeps against a light plane: mean, scatter and trend on each surface, and the probable cause.

Residuals are um along the light plane's normal: (t - a . X - b) / |a|.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from . import robust
from .joint import BoardShift
from .surfaces import Surface

F8 = NDArray[np.float64]
LIMIT_UM = 1.0
"""A surface whose mean residual is larger contradicts the others."""
MOVED_CHI2 = 30.0
"""Chi squared (6 degrees of freedom) beyond which the light moved a board by more than the noise of its corners."""
BEND_LIMIT_UM = 3.0
"""Curved trend over the field beyond which something is not flat or not straight."""


@dataclass(frozen=True)
class SurfaceResult:
    """Residuals of one surface."""

    name: str
    pixels: int
    outlier_share: float
    mean_um: float
    """Mean residual along the light plane's normal."""
    rms_um: float
    """Root mean square of the pixels that are not outliers."""
    slope_um: float
    """Greatest linear trend of the residual over the field, end to end."""
    bend_um: float
    """Greatest curved trend."""
    height_mm: float | None
    """Estimated height of a flat; None for boards."""
    ok: bool
    cause: str
    map_um: F8
    """[h, w] residual; NaN where not used."""
    board_shift: BoardShift | None = None
    """Displacement by light and other boards from the pose of its own corners; None for flats."""


def surface_results(
    surfaces: Sequence[Surface], points: Sequence[F8], heights: F8, a: F8, b: float, shifts: Sequence[BoardShift | None]
) -> tuple[SurfaceResult, ...]:
    """Residuals of each surface against t = a . X + b; ``points`` [n, 3] and ``heights`` (of flats) in mm, one each."""
    found = []
    for surface, x, height, away in zip(surfaces, points, heights, shifts, strict=True):
        shape = surface.sweep.crossing.shape
        residual = (surface.sweep.t.ravel()[surface.pixels] - x @ a - b) / float(np.linalg.norm(a)) * 1000
        middle, scale = robust.median_and_scale(residual)
        near = np.abs(residual - middle) <= 4 * max(scale, 1e-9)
        whole = np.full(shape[0] * shape[1], np.nan)
        whole[surface.pixels[near]] = residual[near]
        slope, bend = _trend(surface.pixels[near], residual[near], shape)
        mean = float(residual[near].mean())
        rms = float(np.sqrt((residual[near] ** 2).mean()))
        ok = abs(mean) <= LIMIT_UM and bend <= BEND_LIMIT_UM and not _contradicts_corners(away)
        result = SurfaceResult(
            surface.sweep.name, int(near.sum()), float(1 - near.mean()), mean, rms,
            slope, bend, float(height) if surface.free_height else None, ok, "",
            whole.reshape(shape), away,
        )  # fmt: skip
        found.append(replace(result, cause=_cause(result)))
    return tuple(found)


def _contradicts_corners(shift: BoardShift | None) -> bool:
    """True if the light contradicts the corners of a board, by an amount that matters."""
    return shift is not None and shift.chi2 > MOVED_CHI2 and shift.um > LIMIT_UM


def _trend(pixels: NDArray[np.intp], residual: F8, shape: tuple[int, ...]) -> tuple[float, float]:
    """Linear and curved trend of the residual over the field, greatest minus least, in um."""
    y, x = np.divmod(pixels, shape[1])
    u, v = 2 * x / (shape[1] - 1) - 1, 2 * y / (shape[0] - 1) - 1
    linear = np.column_stack([u, v])
    curved = np.column_stack([u * u, u * v, v * v])
    curved = curved - curved.mean(axis=0)
    design = np.column_stack([np.ones(len(u)), linear, curved])
    fit = np.linalg.lstsq(design, residual, rcond=None)[0]
    return float(np.ptp(linear @ fit[1:3])), float(np.ptp(curved @ fit[3:]))


def _cause(result: SurfaceResult) -> str:
    """Probable cause of a wrong residual as text; empty where nothing is wrong."""
    if result.bend_um > BEND_LIMIT_UM:
        return (
            f"its residual is bent by {result.bend_um:.1f} um: the surface is not flat, the stage not straight, or the "
            "lens distorts otherwise than calibrated"
        )
    if result.board_shift is not None and _contradicts_corners(result.board_shift):
        return (
            f"light and the others put it {result.board_shift.um:.1f} um from where its corners do, "
            f"{result.board_shift.chi2:.0f} variances (six would be chance): the board moved, the stage was homed or "
            "lost steps, or its squares are uneven or too coarsely seen"
        )
    if result.slope_um > 4 * LIMIT_UM:
        return (
            f"its residual slopes by {result.slope_um:.1f} um: its pose is wrong (a board that moved during the sweep)"
        )
    if not result.ok:
        return f"it lies {result.mean_um:+.1f} um off the others: the board moved, the stage was homed, or lost steps"
    return ""
