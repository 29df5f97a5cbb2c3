"""Difference of two light planes: direction, speed, and the points that they give over the volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel, TranslatingPlane
from acquire.contract.errors import CalibrationError
from process.cloud.triangulation import rays

F8 = NDArray[np.float64]
HEIGHTS_MM = (0.0, 0.5, 1.0)
PLACES = 5
"""Number of places compared, across and down the picture."""


@dataclass(frozen=True)
class PlaneDifference:
    """The second light plane against the first."""

    angle_deg: float
    speed_percent: float
    """Along the normal, per unit of t."""
    heights_mm: tuple[float, ...]
    along_ray_um: F8
    """[heights, PLACES, PLACES]: displacement of points towards the camera, at places of the picture."""

    def lines(self, first: str, second: str) -> list[str]:
        """The difference as lines of text, with the names of both planes."""
        lines = [
            f"{second} against {first}: normals differ by {self.angle_deg:.4f} degrees, speeds along them by "
            f"{self.speed_percent:+.4f} %"
        ]
        for height, table in zip(self.heights_mm, self.along_ray_um, strict=True):
            row, column = np.unravel_index(int(np.abs(table).argmax()), table.shape)
            where = f"{('top', 'middle', 'bottom')[2 * row // (PLACES - 1)]} "\
                f"{('left', 'middle', 'right')[2 * column // (PLACES - 1)]}"  # fmt: skip
            lines.append(
                f"  {height:g} mm above z = 0: points differ by {table.mean():+.2f} um on average, most "
                f"({table[row, column]:+.2f} um) at the {where} of the picture"
            )
        return lines


def difference(first: TranslatingPlane, second: TranslatingPlane, camera: CameraModel) -> PlaneDifference:
    """How the second plane differs from the first.

    Raises:
        CalibrationError: they count in different units.
    """
    if first.parameter != second.parameter:
        raise CalibrationError(f"one light plane counts in {first.parameter}, the other in {second.parameter}")
    (n1, b1, s1), (n2, b2, s2) = (_plane(plane) for plane in (first, second))
    x, y = np.meshgrid(np.linspace(0, camera.width - 1, PLACES), np.linspace(0, camera.height - 1, PLACES))
    view = rays(camera, np.column_stack([x.ravel(), y.ravel()]))
    length = np.linalg.norm(view.directions, axis=1)
    found = []
    for height in HEIGHTS_MM:
        at = (height - view.centre_mm[2]) / view.directions[:, 2]
        place = view.centre_mm + at[:, None] * view.directions
        t = (place @ n1 - b1) / s1
        moved = (b2 + s2 * t - view.centre_mm @ n2) / (view.directions @ n2)
        found.append(((at - moved) * length * 1000).reshape(PLACES, PLACES))
    angle = float(np.degrees(np.arccos(min(abs(float(n1 @ n2)), 1.0))))
    return PlaneDifference(angle, 100 * (abs(s2 / s1) - 1), HEIGHTS_MM, np.array(found))


def _plane(plane: TranslatingPlane) -> tuple[F8, float, float]:
    """Unit normal, n . origin, n . velocity."""
    normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
    return normal, float(normal @ plane.corner_origin_mm), float(normal @ plane.corner_velocity_mm)
