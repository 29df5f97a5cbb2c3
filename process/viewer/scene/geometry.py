"""What a calibration tells about the space of a scan: the field of view on z = 0, and where the light is. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import Calibration, CameraModel, PerFramePlanes
from acquire.contract.plan import SweepPlan
from process.cloud.light_planes import planes_at
from process.viewer.rig_client.tile import BoundingBox

MAX_FIELD_MM = 10_000.0
REACH = 1.5
"""A light plane further from the centre of the object than so many radii is not drawn."""
LYING = 0.1
"""A plane with less slope than this has no height to stand up to."""
HEADROOM = 0.25
"""The sheet of light ends so many radii over the object."""


def camera_eye(camera: CameraModel) -> NDArray[np.float64]:
    """The pinhole u = -R^T T, shape [3] in mm."""
    eye: NDArray[np.float64] = -np.asarray(camera.R).T @ np.asarray(camera.T)
    return eye


def field_of_view(camera: CameraModel) -> BoundingBox | None:
    """The box around the image's corners projected onto z = 0 (docs/design.md, section 5); None if a ray misses it."""
    rotation, translation = np.asarray(camera.R), np.asarray(camera.T)
    corners = np.array(
        [(x, y, 1.0) for x in (-0.5, camera.width - 0.5) for y in (-0.5, camera.height - 0.5)], dtype=np.float64
    )
    eye = -rotation.T @ translation
    # X_cam = R X + T (equation 1), so a ray has the direction R^T K^-1 (x, y, 1) from u = -R^T T
    rays = corners @ np.linalg.inv(np.asarray(camera.K)).T @ rotation
    if (np.abs(rays[:, 2]) < 1e-12).any():
        return None
    along = -eye[2] / rays[:, 2]
    points = eye + along[:, None] * rays
    if (along <= 0).any() or not (np.abs(points) < MAX_FIELD_MM).all():
        return None
    low, high = points.min(axis=0), points.max(axis=0)
    return BoundingBox((float(low[0]), float(low[1]), 0.0), (float(high[0]), float(high[1]), 0.0))


def sweep_coordinate(parameter: str, plan: SweepPlan | None, position_steps: int, position_um: float) -> float | None:
    """The parameter t of a light plane at a stage position: t = frame index + 1, or um; None without a plan."""
    if parameter != "frame":
        return position_um
    return (position_steps - plan.first_steps) / plan.pitch_steps + 1 if plan is not None else None


def light_at(
    calibration: Calibration, plan: SweepPlan | None, position_steps: int, position_um: float
) -> tuple[NDArray[np.float64], float] | None:
    """Unit normal n and d of the light plane n . X = d at a stage position; None where it is not known."""
    light = calibration.light_plane
    t = sweep_coordinate(light.parameter, plan, position_steps, position_um) if light is not None else None
    if light is None or t is None:
        return None
    if isinstance(light, PerFramePlanes):
        if not light.first_frame <= t <= light.last_frame:
            return None
        coefficients = planes_at(light, np.array([t]))[0]
        if np.isnan(coefficients[0]):
            return None
        normal, offset = coefficients[:3], float(coefficients[3])
    else:
        normal = np.asarray(light.normal)
        corner = np.asarray(light.corner_origin_mm) + np.asarray(light.corner_velocity_mm) * t
        offset = float(normal @ corner)
    # a printed normal is not exactly a unit vector
    length = float(np.linalg.norm(normal))
    return normal / length, offset / length


def sheet(normal: NDArray[np.float64], offset: float, bounds: BoundingBox) -> NDArray[np.float64] | None:
    """Four corners, shape [4, 3] in mm, of the piece of the plane that stands over the floor of ``bounds``.

    It is as wide as the box, and reaches from z = 0 a little over the box. None where the plane passes the box by.
    """
    radius = bounds.radius_mm
    centre = bounds.centre - (float(normal @ bounds.centre) - offset) * normal
    if float(np.linalg.norm(centre - bounds.centre)) > REACH * radius:
        return None
    level = np.cross(normal, (0.0, 0.0, 1.0))
    if np.linalg.norm(level) < LYING:
        level, rise = np.array([1.0, 0.0, 0.0]), np.cross(normal, (1.0, 0.0, 0.0))
        low, high = -radius, radius
    else:
        level /= np.linalg.norm(level)
        rise = np.cross(level, normal)
        top_mm = bounds.high[2] + HEADROOM * radius
        low, high = sorted((-centre[2] / rise[2], (top_mm - centre[2]) / rise[2]))
    half = np.abs(level) @ (np.asarray(bounds.high) - np.asarray(bounds.low)) / 2
    return np.array([centre + a * half * level + b * rise for a, b in ((-1, low), (1, low), (1, high), (-1, high))])


def box_edges(box: BoundingBox) -> NDArray[np.float32]:
    """The twelve edges of a box as line segments, shape [12, 2, 3] in mm."""
    ends = np.array([box.low, box.high])
    corners = [np.array([ends[i, 0], ends[j, 1], ends[k, 2]]) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    pairs = [(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b).bit_count() == 1]
    return np.array([[corners[a], corners[b]] for a, b in pairs], np.float32)
