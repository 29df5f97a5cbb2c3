"""Owns the optics of the slide projector: from the quarter circle's edges to the light plane (equations 5 to 10).

An edge of length d is hp cos(alpha) / cos(alpha + theta) long (equation 5), so theta is +-arccos(hp cos(alpha) / d) -
alpha: positive where the edge leads away from the projector, negative where it leads towards it. Equation 6 has the
first only, which is wrong by 2 alpha (8.7 degrees) for an edge that leads towards the projector.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError

F8 = NDArray[np.float64]


@dataclass(frozen=True)
class Slide:
    """Sizes of slide and lens in mm; the defaults are the paper's."""

    radius_mm: float = 3.81
    """Of the quarter circle on the slide, hs."""
    focal_mm: float = 50.0
    """Of the lens, f."""
    slide_to_lens_mm: float = 102.32
    """xb."""

    @property
    def hp_mm(self) -> float:
        """Radius of the projected quarter circle square to the axis, hp = hs f / xb."""
        return self.radius_mm * self.focal_mm / self.slide_to_lens_mm

    @property
    def half_angle(self) -> float:
        """alpha = arctan(hs / f), rad."""
        return float(np.arctan(self.radius_mm / self.focal_mm))

    def turns(self, length_mm: float, name: str) -> tuple[float, float]:
        """Both angles theta in rad that an edge of this length allows: away from the projector, and towards it.

        Raises:
            CalibrationError: the edge is shorter than the optics allow (hp / d > 1), with the numbers.
        """
        share = self.hp_mm * np.cos(self.half_angle) / length_mm
        if share > 1:
            raise CalibrationError(
                f"impossible geometry: the {name} is {length_mm:.4f} mm long, and hp is {self.hp_mm:.4f} mm "
                f"(hp / d = {self.hp_mm / length_mm:.3f} > 1): wrong points, scale (--square-mm of the camera), "
                "height of the flat, or sizes of the slide"
            )
        angle = float(np.arccos(share))
        return angle - self.half_angle, -angle - self.half_angle

    def taper(self, theta: float) -> float:
        """Linear coefficient per mm of the arc's conic along an edge turned by ``theta``: the cone gets narrower."""
        return float(-2 * np.tan(self.half_angle) * np.sin(theta) / self.hp_mm)


def plane_normal(lead: F8, side: F8, turns: tuple[float, float], velocity: F8) -> F8:
    """Unit normal of the leading light plane, along the motion.

    Args:
        lead: [3] mm, from the corner to the end of the leading edge, in the flat.
        side: [3] mm, from the corner to the end of the other straight edge, in the flat.
        turns: theta of the leading and of the other edge, rad.
        velocity: [3] of the corner.
    """
    e1, e2, up = side / np.linalg.norm(side), lead / np.linalg.norm(lead), np.array([0.0, 0.0, 1.0])
    # the projector is above the flat, whichever way round the pattern lies: e3 is up (7c)
    v1 = np.cos(turns[1]) * e1 + np.sin(turns[1]) * up
    v2 = np.cos(turns[0]) * e2 + np.sin(turns[0]) * up
    axis = np.cross(v1, v2)
    normal = np.cross(axis, lead)
    normal /= np.linalg.norm(normal)
    return np.asarray(normal if normal @ velocity > 0 else -normal)
