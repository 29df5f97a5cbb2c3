"""Owns the verdict on a calibration: figures, their limits from rig.toml, and whether each is within."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquire.contract.config.model import CheckConfig
from acquire.contract.errors import CalibrationError

from .planarity import CheckResult, Repeatability
from .spheres import Sphere


@dataclass(frozen=True)
class Figure:
    """One figure and its limit."""

    name: str
    value: float
    limit: float
    unit: str

    @property
    def ok(self) -> bool:
        """Within the limit."""
        return abs(self.value) <= self.limit

    def words(self) -> str:
        """For people."""
        verdict = "passed" if self.ok else "FAILED"
        return f"{self.name} {self.value:+.3f} {self.unit} (limit {self.limit:g}): {verdict}"


def of_surface(result: CheckResult, limits: CheckConfig) -> list[Figure]:
    """Of a board or a flat."""
    figures = [
        Figure("flatness error", result.flatness_error_um, limits.flatness_um, "um"),
        Figure("flatness error, 95 % of the points", result.flatness_range_um, limits.flatness_um, "um"),
    ]
    if result.offset_um is not None:
        figures.append(Figure("offset from the board's pose", result.offset_um, limits.offset_um, "um"))
    if result.scale is not None:
        figures.append(Figure("scale against the board's squares", result.scale.percent, limits.scale_percent, "%"))
    return figures


def of_repeat(result: Repeatability, limits: CheckConfig) -> list[Figure]:
    """Of two sweeps over the same thing."""
    return [
        Figure("shift between the sweeps", result.shift_um, limits.repeatability_um, "um"),
        Figure("repeatability of a point (standard deviation)", result.sd_um, limits.repeatability_um, "um"),
    ]


def of_spheres(
    spheres: Sequence[Sphere], diameters_mm: Sequence[float], spacing_mm: float | None, limits: CheckConfig
) -> list[Figure]:
    """Of one sphere or two; their diameters in the order of size of what is seen of them.

    Raises:
        CalibrationError: other spheres than given.
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
        figures.append(Figure(f"{name}: probing error, form", own.form_um, limits.probing_form_um, "um"))
        size = 1000 * (own.diameter_mm - diameter)
        figures.append(Figure(f"{name}: probing error, size", size, limits.probing_size_um, "um"))
    if spacing_mm is not None:
        if len(chosen) != 2:
            raise CalibrationError("the distance of two spheres needs two: give --sphere-mm twice")
        error = 1000 * (float(np.linalg.norm(chosen[0].centre - chosen[1].centre)) - spacing_mm)
        figures.append(Figure("sphere-spacing error", error, limits.sphere_spacing_um, "um"))
    return figures
