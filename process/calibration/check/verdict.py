"""Verdict on a calibration: measured figures against their limits in rig.toml."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquire.contract.config.model import CheckConfig
from acquire.contract.errors import CalibrationError

from .planarity import CheckResult, Repeatability
from .spheres import Sphere


@dataclass(frozen=True)
class CheckedFigure:
    """A measured figure and its limit."""

    name: str
    value: float
    limit: float
    unit: str

    @property
    def ok(self) -> bool:
        """True if within the limit."""
        return abs(self.value) <= self.limit

    def text(self) -> str:
        """The figure, its limit and the verdict."""
        verdict = "passed" if self.ok else "FAILED"
        return f"{self.name} {self.value:+.3f} {self.unit} (limit {self.limit:g}): {verdict}"


def surface_figures(result: CheckResult, limits: CheckConfig) -> list[CheckedFigure]:
    """Figures of a board or a flat."""
    figures = [
        CheckedFigure("flatness error", result.flatness_error_um, limits.flatness_um, "um"),
        CheckedFigure("flatness error, 95 % of the points", result.flatness_range_um, limits.flatness_um, "um"),
    ]
    if result.offset_um is not None:
        figures.append(CheckedFigure("offset from the board's pose", result.offset_um, limits.offset_um, "um"))
    if result.scale is not None:
        figures.append(
            CheckedFigure("scale against the board's squares", result.scale.percent, limits.scale_percent, "%")
        )
    return figures


def repeatability_figures(result: Repeatability, limits: CheckConfig) -> list[CheckedFigure]:
    """Figures of two sweeps over the same object."""
    return [
        CheckedFigure("shift between the sweeps", result.shift_um, limits.repeatability_um, "um"),
        CheckedFigure("repeatability of a point (standard deviation)", result.sd_um, limits.repeatability_um, "um"),
    ]


def sphere_figures(
    spheres: Sequence[Sphere], diameters_mm: Sequence[float], spacing_mm: float | None, limits: CheckConfig
) -> list[CheckedFigure]:
    """Figures of one sphere or two with known diameters.

    Raises:
        CalibrationError: fewer spheres were found than given.
    """
    if len(spheres) < len(diameters_mm):
        raise CalibrationError(
            f"{len(spheres)} spheres were found, {len(diameters_mm)} were given: are all in the field?"
        )
    left, figures, chosen = list(spheres), [], []
    for diameter in diameters_mm:
        own = min(left, key=lambda sphere: abs(sphere.diameter_mm - diameter))  # noqa: B023 - used at once
        left.remove(own)
        chosen.append(own)
        name = f"sphere of {diameter:g} mm"
        figures.append(CheckedFigure(f"{name}: probing error, form", own.form_um, limits.probing_form_um, "um"))
        size = 1000 * (own.diameter_mm - diameter)
        figures.append(CheckedFigure(f"{name}: probing error, size", size, limits.probing_size_um, "um"))
    if spacing_mm is not None:
        if len(chosen) != 2:
            raise CalibrationError("the distance of two spheres needs two: give --sphere-mm twice")
        error = 1000 * (float(np.linalg.norm(chosen[0].centre - chosen[1].centre)) - spacing_mm)
        figures.append(CheckedFigure("sphere-spacing error", error, limits.sphere_spacing_um, "um"))
    return figures
