"""Owns how uncertain a light plane is: pixels that err together, boards' poses, and the camera that saw them all.

Every source is carried to (a, b) of t = a . X + b by finite differences along the axes of its own covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from acquire.contract.errors import CalibrationError

from .boards import Sighting
from .poses import Pose
from .surfaces import Surface

F8 = NDArray[np.float64]
PIXELS = 1500
"""Per surface: enough to see where (a, b) goes when a pose or the camera changes."""
PATCHES_ACROSS = 16
"""Pixels within a sixteenth of the picture's width are taken to err together."""
INTRINSICS = 9
_INTRINSIC_COLUMNS = slice(6, 15)
_POSE_COLUMNS = slice(0, 6)


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
    """[15, 15] of the intrinsics and the world's pose as a calibration of ours keeps it; None where it does not.

    Raises:
        CalibrationError: it is there, and is none.
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


def pose_blocks(view: Sighting, pose: F8, matrix: F8, distortion: F8) -> tuple[F8, F8]:
    """Covariance [6, 6] of a pose per px^2 of corner noise, and its change [6, 9] with the intrinsics."""
    jacobian = cv2.projectPoints(view.object_mm, pose[:3], pose[3:], matrix, distortion)[1]
    own = jacobian[:, _POSE_COLUMNS]
    inverse: F8 = np.linalg.pinv(own.T @ own, hermitian=True)
    follows: F8 = -inverse @ own.T @ jacobian[:, _INTRINSIC_COLUMNS]
    return inverse, follows


def corner_variance(view: Sighting, rms_px: float) -> float:
    """Variance in px^2 of one coordinate of a corner, from what is left after the pose was fitted."""
    count = len(view.pixels)
    return rms_px**2 * count / max(2 * count - 6, 1)


def clustered(design: F8, residual: F8, weight: F8, group: NDArray[np.intp]) -> F8:
    """Covariance of weighted least squares whose errors are alike within groups: bread, meat, bread.

    Args:
        design: [n, k].
        residual: [n].
        weight: [n], of the squares.
        group: [n], which rows err together.
    """
    unit = np.sqrt((design**2).mean(axis=0))
    rows = design / unit
    bread = np.linalg.pinv(rows.T @ (rows * weight[:, None]), hermitian=True)
    pull = rows * (weight * residual)[:, None]
    count = int(group.max()) + 1
    sums = np.stack([np.bincount(group, column, count) for column in pull.T], axis=1)
    groups = len(np.unique(group))
    meat = sums.T @ sums * groups / max(groups - design.shape[1], 1)
    return np.asarray(bread @ meat @ bread / np.outer(unit, unit))


def patches(surfaces: Sequence[Surface]) -> NDArray[np.intp]:
    """Number of the patch of each pixel of all surfaces, one after the other."""
    found, first = [], 0
    for surface in surfaces:
        height, width = surface.sweep.crossing.shape
        side = max(width // PATCHES_ACROSS, 1)
        row, column = np.divmod(surface.pixels, width)
        found.append(first + (row // side) * (width // side + 1) + column // side)
        first += (height // side + 1) * (width // side + 1)
    return np.concatenate(found).astype(np.intp)


def spread(
    surfaces: Sequence[Surface], heights: F8, camera: CameraModel, weight: F8, pixels: F8, known_camera: F8 | None
) -> Spread:
    """Covariances of (a, b).

    Args:
        surfaces: as fitted; boards carry their corners.
        heights: [surfaces] mm, of flats.
        camera: with its pose in the world.
        weight: [n] of the squares, of all pixels in the surfaces' order.
        pixels: [4, 4], the pixels' own part.
        known_camera: [15, 15] of the intrinsics and the world's pose, or None.
    """
    solve = _solver(surfaces, heights, camera, weight)
    start, zeros = np.zeros(INTRINSICS + 6), [np.zeros(6) for _ in surfaces]
    poses = np.zeros((4, 4))
    for index, surface in enumerate(surfaces):
        if surface.sighting is None or surface.pose is None:
            continue
        matrix, distortion = np.array(camera.K), np.array(camera.distortion)
        inverse, _ = pose_blocks(surface.sighting, _vector(surface.pose), matrix, distortion)
        own = inverse * corner_variance(surface.sighting, surface.pose.rms_px)

        def moved(step: F8, index: int = index) -> F8:
            return solve(start, [step if k == index else none for k, none in enumerate(zeros)])

        poses += _carried(own, moved)
    by_camera = np.zeros((4, 4))
    if known_camera is not None:
        by_camera = _carried(known_camera, lambda step: solve(step, zeros))
    return Spread(pixels, poses, by_camera)


def _carried(covariance: F8, function: Callable[[F8], F8]) -> F8:
    """Covariance of ``function`` of a small step, by central differences along the covariance's axes."""
    values, vectors = np.linalg.eigh(covariance)
    total = np.zeros((4, 4))
    for value, axis in zip(values, vectors.T, strict=True):
        if value <= 1e-12 * values[-1]:
            continue
        step = np.sqrt(value) * axis
        change = (function(step) - function(-step)) / 2
        total += np.outer(change, change)
    return total


def _solver(
    surfaces: Sequence[Surface], heights: F8, camera: CameraModel, weight: F8
) -> Callable[[F8, Sequence[F8]], F8]:
    """(a, b) as a function of steps of intrinsics and world [15], and of each pose [6]."""
    matrix, distortion = np.array(camera.K), np.array(camera.distortion)
    turn, shift = cv2.Rodrigues(np.array(camera.R))[0].ravel(), np.array(camera.T)
    ends = np.cumsum([len(surface.pixels) for surface in surfaces])
    parts = []
    for surface, weights in zip(surfaces, np.split(weight, ends[:-1]), strict=True):
        every = slice(None, None, max(len(surface.pixels) // PIXELS, 1))
        answer = None
        if surface.sighting is not None and surface.pose is not None:
            answer = pose_blocks(surface.sighting, _vector(surface.pose), matrix, distortion)[1]
        row, column = np.divmod(surface.pixels[every], camera.width)
        places = np.column_stack([column, row]).astype(np.float64)
        parts.append((places, surface.sweep.t.ravel()[surface.pixels[every]], weights[every], answer))
    t = np.concatenate([part[1] for part in parts])
    root = np.sqrt(np.concatenate([part[2] for part in parts]))

    def solve(step: F8, pose_steps: Sequence[F8]) -> F8:
        intrinsics = step[:INTRINSICS]
        moved = matrix + np.array([[intrinsics[0], 0, intrinsics[2]], [0, intrinsics[1], intrinsics[3]], [0, 0, 0]])
        lens = distortion + intrinsics[4:]
        world = cv2.Rodrigues(turn + step[INTRINSICS : INTRINSICS + 3])[0]
        origin = shift + step[INTRINSICS + 3 :]
        points = []
        for surface, height, pose_step, (places, _, _, answer) in zip(
            surfaces, heights, pose_steps, parts, strict=True
        ):
            flat = cv2.undistortPoints(places.reshape(-1, 1, 2), moved, lens).reshape(-1, 2)
            directions = np.column_stack([flat, np.ones(len(flat))])
            if surface.pose is None or answer is None:
                normal, point = world[:, 2], world @ (surface.point + height * surface.normal) + origin
            else:
                pose = _vector(surface.pose) + pose_step + answer @ intrinsics
                normal, point = cv2.Rodrigues(pose[:3])[0][:, 2], pose[3:]
            seen = (normal @ point / (directions @ normal))[:, None] * directions
            points.append((seen - origin) @ world)
        design = np.column_stack([np.concatenate(points), np.ones(len(t))])
        return np.asarray(np.linalg.lstsq(design * root[:, None], t * root, rcond=None)[0], dtype=np.float64)

    return solve


def _vector(pose: Pose) -> F8:
    return np.concatenate([pose.rotation_vector, pose.translation])
