"""Optics of the slide projector: light plane from the edges of the projected quarter circle (equations 5 to 10).

An edge of length d is hp cos(alpha) / cos(alpha + theta) long (equation 5), so theta = +-arccos(hp cos(alpha) / d) -
alpha: positive where the edge leads away from the projector, negative where it leads towards it. Equation 6 of the
paper has the first solution only, which is wrong by 2 alpha (8.7 degrees) for an edge that leads towards the projector.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError

F8 = NDArray[np.float64]
UP: F8 = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Slide:
    """Sizes of slide and lens in mm; the defaults are the paper's."""

    radius_mm: float = 3.81
    """hs: radius of the quarter circle on the slide."""
    focal_mm: float = 50.0
    """f: focal length of the lens."""
    slide_to_lens_mm: float = 102.32
    """xb: distance of slide and lens."""

    @property
    def hp_mm(self) -> float:
        """Radius of the projected quarter circle square to the axis, hp = hs f / xb."""
        return self.radius_mm * self.focal_mm / self.slide_to_lens_mm

    @property
    def half_angle(self) -> float:
        """alpha = arctan(hs / f), rad."""
        return float(np.arctan(self.radius_mm / self.focal_mm))

    def turns(self, length_mm: float, name: str) -> tuple[float, float]:
        """Both angles theta in rad of an edge of this length (equation 6): away from the projector, and towards it.

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
        """Linear coefficient (per mm) of the arc's conic along an edge turned by ``theta``: the cone gets narrower."""
        return float(-2 * np.tan(self.half_angle) * np.sin(theta) / self.hp_mm)


def plane_normal(lead: F8, side: F8, turns: tuple[float, float], velocity: F8, up: F8 = UP) -> F8:
    """Unit normal of the leading light plane, along the motion (equations 7 to 10).

    Args:
        lead: [3] mm, from the corner to the end of the leading edge, in the flat.
        side: [3] mm, from the corner to the end of the other straight edge, in the flat.
        turns: theta of the leading and of the other edge, rad.
        velocity: [3] of the corner.
        up: e3 of equation 7c. The projector is above the flat, whichever way round the pattern lies.
    """
    e1, e2 = side / np.linalg.norm(side), lead / np.linalg.norm(lead)  # equations 7a and 7b
    # equations 8a and 8b: the edges as they would be on a plane square to the optical axis
    v1 = np.cos(turns[1]) * e1 + np.sin(turns[1]) * up
    v2 = np.cos(turns[0]) * e2 + np.sin(turns[0]) * up
    # equations 9 and 10: F - c is parallel to v1 x v2, and the light plane holds F, c and the leading edge
    axis = np.cross(v1, v2)
    normal = np.cross(axis, lead)
    normal /= np.linalg.norm(normal)
    return np.asarray(normal if normal @ velocity > 0 else -normal)
