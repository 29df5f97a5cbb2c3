"""Uncertainty of a light plane by source (pixels, poses of boards, camera), and of the points it gives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError

from .joint_residuals import INTRINSICS, POSE, CameraState, camera_state, central_differences

F8 = NDArray[np.float64]
HEIGHTS_MM = (0.0, 0.5)
"""Heights at which the error of points is predicted: on the stage, and half a millimetre above."""
_STEPS = np.array([1e-2, 1e-2, 1e-2, 1e-2, 1e-4, 1e-2, 1e-5, 1e-5, 1.0, 1e-6, 1e-6, 1e-6, 1e-5, 1e-5, 1e-5])


@dataclass(frozen=True)
class Spread:
    """Covariances [4, 4] of (a, b) by source."""

    pixels: F8
    poses: F8
    camera: F8
    """Zero where the camera's file does not say how uncertain it is."""

    @property
    def total(self) -> F8:
        """Their sum: the sources are independent."""
        return self.pixels + self.poses + self.camera


def camera_covariance(document: dict[str, Any]) -> F8 | None:
    """Covariance [15, 15] of the intrinsics and the world's pose in a calibration; None where it has none.

    Raises:
        CalibrationError: it is no such matrix.
    """
    values = (document.get("camera", {}).get("quality") or {}).get("covariance")
    if values is None:
        return None
    try:
        found = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape != (INTRINSICS + 6, INTRINSICS + 6) or not np.isfinite(found).all():
        raise CalibrationError("camera.quality.covariance is no 15 x 15 matrix: calibrate the camera again")
    return found


def predicted_um(camera_and_light: F8, covariance: F8, size: tuple[int, int]) -> tuple[float, ...]:
    """Standard deviation of a point at the worst corner of the field, at each of HEIGHTS_MM.

    Args:
        camera_and_light: [19] intrinsics, stage, and a, b of t = a . X + b, X in the world.
        covariance: [19, 19] of these.
        size: width and height of the picture.
    """
    places = np.array([[x, y] for x in (0.0, size[0] - 1.0) for y in (0.0, size[1] - 1.0)])
    steps = np.append(_STEPS, np.array([1e-6, 1e-6, 1e-6, 1e-6]) * np.linalg.norm(camera_and_light[15:18]))
    found = []
    for height in HEIGHTS_MM:
        t = _at_height(camera_and_light, places, height)
        roots = central_differences(partial(_points, places=places, t=t), camera_and_light, steps)  # [19, places, 3]
        squares = np.einsum("ipk,ij,jpk->p", roots, covariance, roots)
        found.append(1000 * float(np.sqrt(squares.max())))
    return tuple(found)


def _at_height(camera_and_light: F8, places: F8, height: float) -> F8:
    """t [n] at which the light meets each pixel's ray at this height."""
    centre, rays = _rays(camera_state(camera_and_light[: INTRINSICS + POSE]), places)
    points = centre + ((height - centre[2]) / rays[:, 2])[:, None] * rays
    return np.asarray(points @ camera_and_light[15:18] + camera_and_light[18], dtype=np.float64)


def _points(camera_and_light: F8, places: F8, t: F8) -> F8:
    """Points [n, 3] where the light at t [n] meets each pixel's ray (equations 2 and 4)."""
    centre, rays = _rays(camera_state(camera_and_light[: INTRINSICS + POSE]), places)
    a, b = camera_and_light[15:18], camera_and_light[18]
    return np.asarray(centre + ((t - b - a @ centre) / (rays @ a))[:, None] * rays, dtype=np.float64)


def _rays(seen: CameraState, places: F8) -> tuple[F8, F8]:
    flat = cv2.undistortPoints(places.reshape(-1, 1, 2), seen.matrix, seen.distortion).reshape(-1, 2)
    return -seen.rotation.T @ seen.translation, np.column_stack([flat, np.ones(len(flat))]) @ seen.rotation
