"""Bundle adjustment: least-squares fit of one camera and the poses of all its views, with covariance.

Equation 1 of the paper with OpenCV's distortion k1 k2 p1 p2 k3; px, mm, rotation vectors in rad; float64. OpenCV's own
calibrateCamera takes no start poses and stays in the mirrored pose of a nearly telecentric view
(docs/decisions/0001-dependencies.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from process.calibration.board.detection import Sighting
from process.calibration.board.poses import PlanePose, find_pose, project

F8 = NDArray[np.float64]
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
_COLUMNS = (6, 7, 8, 9, 10, 11, 12, 13, 14)
"""Columns of NAMES in the Jacobian of cv2.projectPoints, after rotation and translation."""
MODELS: dict[str, tuple[int, ...]] = {
    "none": (0, 1, 2, 3),
    "k1": (0, 1, 2, 3, 4),
    "k1 k2": (0, 1, 2, 3, 4, 5),
    "k1 k2 p1 p2": (0, 1, 2, 3, 4, 5, 6, 7),
    "k1 k2 p1 p2 k3": (0, 1, 2, 3, 4, 5, 6, 7, 8),
}
"""Distortion models from few terms to many: indices of the free parameters."""
FIRST_FOCAL_SHARES = (0.8, 1.5, 3.0, 6.0, 11.0, 20.0)
"""Start values of the focal length in picture widths: from a webcam to a microscope lens."""
ROUGH_CORNERS = 60
CONVERGED = 1e-10
MAX_ROUNDS = 60


def camera_matrix(intrinsics: F8) -> F8:
    """K [3, 3] of intrinsics that begin with fx fy cx cy."""
    fx, fy, cx, cy = intrinsics[:4]
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class CameraFit:
    """A fitted camera and the poses of its views."""

    intrinsics: F8
    """[9], see NAMES."""
    poses: tuple[F8, ...]
    """[6] each: rotation vector, translation."""
    covariance: F8
    """[9, 9] of the intrinsics; zero for those that were not free."""
    rms_px: float
    """Root mean square distance over all corners, as OpenCV defines it."""
    view_rms_px: tuple[float, ...]
    model: str
    corner_variance: float = 0.0
    """Variance of one coordinate of a corner in px^2, from the residuals."""

    @property
    def matrix(self) -> F8:
        """K."""
        return camera_matrix(self.intrinsics)

    @property
    def distortion(self) -> F8:
        """k1 k2 p1 p2 k3."""
        return self.intrinsics[4:]

    def residuals(self, index: int, view: Sighting) -> F8:
        """Predicted minus measured corners of a view, [n, 2] px."""
        pose = self.poses[index]
        return project(view.object_mm, pose[:3], pose[3:], self.matrix, self.distortion) - view.pixels


def fit_camera(
    views: Sequence[Sighting], size: tuple[int, int], model: str, start: CameraFit | None = None
) -> CameraFit:
    """Fit camera and poses; without ``start`` from several focal lengths, and with both poses of every view.

    Args:
        views: at least three of differing tilt.
        size: width and height of the pictures.
        model: a key of MODELS.
        start: an earlier fit of the same views.
    """
    free = MODELS[model]
    if start is not None:
        intrinsics = np.where(np.isin(np.arange(9), free), start.intrinsics, 0.0)
        return _refine(views, intrinsics, list(start.poses), model, MAX_ROUNDS)
    best: CameraFit | None = None
    few = thinned(views, ROUGH_CORNERS)
    for share in FIRST_FOCAL_SHARES:
        intrinsics = np.zeros(9)
        intrinsics[:4] = share * size[0], share * size[0], (size[0] - 1) / 2, (size[1] - 1) / 2
        rough = _refine(few, intrinsics, _poses(few, intrinsics), "none", 12)
        if best is None or rough.rms_px < best.rms_px:
            best = rough
    assert best is not None
    # poses by the better camera may be the mirrored ones of before: try again from these
    for _ in range(3):
        best = _refine(views, best.intrinsics, list(best.poses), model, MAX_ROUNDS)
        turned = _poses(views, best.intrinsics)
        again = _refine(views, best.intrinsics, turned, model, MAX_ROUNDS)
        if again.rms_px > best.rms_px * (1 - 1e-6):
            break
        best = again
    return best


def thinned(views: Sequence[Sighting], corners: int) -> list[Sighting]:
    """The views with about so many corners each, evenly spread: enough for a start or a comparison."""
    found = []
    for view in views:
        every = max(len(view.pixels) // corners, 1)
        found.append(replace(view, pixels=view.pixels[::every].copy(), board_mm=view.board_mm[::every].copy()))
    return found


def _poses(views: Sequence[Sighting], intrinsics: F8) -> list[F8]:
    matrix = camera_matrix(intrinsics)
    found = [find_pose(view.object_mm, view.pixels, matrix, intrinsics[4:]) for view in views]
    return [as_vector(pose) for pose in found]


def as_vector(pose: PlanePose) -> F8:
    """[6]: rotation vector and translation."""
    return np.concatenate([pose.rotation_vector, pose.translation])


def _refine(views: Sequence[Sighting], intrinsics: F8, poses: list[F8], model: str, rounds: int) -> CameraFit:
    """Levenberg-Marquardt iteration on the normal equations; each pose is eliminated by its Schur complement."""
    free = np.array(MODELS[model])
    damping = 1e-3
    cost, blocks = _normal_equations(views, intrinsics, poses, free)
    for _ in range(rounds):
        step = _step(blocks, damping)
        moved = intrinsics.copy()
        moved[free] += step[0]
        moved_poses = [pose + change for pose, change in zip(poses, step[1], strict=True)]
        valid = moved[0] > 0 and moved[1] > 0 and all(pose[5] > 0 for pose in moved_poses)
        new_cost, new_blocks = _normal_equations(views, moved, moved_poses, free) if valid else (float("inf"), blocks)
        if new_cost < cost:
            gain = (cost - new_cost) / max(cost, 1e-300)
            intrinsics, poses, cost, blocks = moved, moved_poses, new_cost, new_blocks
            damping = max(damping / 10, 1e-12)
            if gain < CONVERGED:
                break
        else:
            damping *= 10
            if damping > 1e8:
                break
    return _finished(views, intrinsics, poses, free, blocks, model)


Blocks = list[tuple[Any, Any, Any, F8, F8]]


def _normal_equations(
    views: Sequence[Sighting], intrinsics: F8, poses: Sequence[F8], free: NDArray[np.intp]
) -> tuple[float, Blocks]:
    """Sum of squares, and for each view (A, B, C, a, b): normal matrix [[A, B], [B^T, C]] and right side (a, b) of
    intrinsics and pose."""
    matrix = camera_matrix(intrinsics)
    total, blocks = 0.0, []
    columns = np.array(_COLUMNS)[free]
    for view, pose in zip(views, poses, strict=True):
        pixels, jacobian = cv2.projectPoints(view.object_mm, pose[:3], pose[3:], matrix, intrinsics[4:])[:2]
        residual = view.pixels.ravel() - np.asarray(pixels, dtype=np.float64).ravel()
        camera, own = jacobian[:, columns], jacobian[:, :6]
        total += float(residual @ residual)
        blocks.append((camera.T @ camera, camera.T @ own, own.T @ own, camera.T @ residual, own.T @ residual))
    return total, blocks


def _step(blocks: Blocks, damping: float) -> tuple[F8, list[F8]]:
    """One damped step of the intrinsics and of each pose."""
    shared = sum(block[0] for block in blocks)
    assert not isinstance(shared, int)
    matrix = shared + damping * np.diag(np.diag(shared))
    right = np.sum([block[3] for block in blocks], axis=0)
    # (A - B C^-1 B^T) x = a - B C^-1 b, summed over the views; then each pose y = C^-1 (b - B^T x)
    solved = []
    for _, between, own, _, own_right in blocks:
        damped = own + damping * np.diag(np.diag(own))
        both = np.linalg.lstsq(damped, np.column_stack([between.T, own_right]), rcond=None)[0]
        solved.append(both)
        matrix = matrix - between @ both[:, :-1]
        right = right - between @ both[:, -1]
    unit = 1 / np.sqrt(np.maximum(np.diag(shared), 1e-300))
    step = unit * np.linalg.lstsq(matrix * np.outer(unit, unit), unit * right, rcond=None)[0]
    return step, [both[:, -1] - both[:, :-1] @ step for both in solved]


def _finished(
    views: Sequence[Sighting], intrinsics: F8, poses: list[F8], free: NDArray[np.intp], blocks: Blocks, model: str
) -> CameraFit:
    reduced = np.sum([block[0] - block[1] @ np.linalg.pinv(block[2]) @ block[1].T for block in blocks], axis=0)
    unit = 1 / np.sqrt(np.maximum(np.diag(reduced), 1e-300))
    fit = CameraFit(intrinsics, tuple(poses), np.zeros((9, 9)), 0.0, (), model)
    squares = [(fit.residuals(index, view) ** 2).sum(axis=1) for index, view in enumerate(views)]
    count = sum(len(part) for part in squares)
    freedom = max(2 * count - len(free) - 6 * len(views), 1)
    variance = float(sum(part.sum() for part in squares)) / freedom
    covariance = np.zeros((9, 9))
    covariance[np.ix_(free, free)] = variance * np.outer(unit, unit) * np.linalg.pinv(reduced * np.outer(unit, unit))
    view_rms = tuple(float(np.sqrt(part.mean())) for part in squares)
    rms = float(np.sqrt(sum(part.sum() for part in squares) / count))
    return CameraFit(intrinsics, tuple(poses), covariance, rms, view_rms, model, variance)


def joint_covariance(fit: CameraFit, view: Sighting, pose: F8) -> F8:
    """Covariance [15, 15] of the intrinsics and of one view's pose [6], which depends on them through its corners."""
    jacobian = cv2.projectPoints(view.object_mm, pose[:3], pose[3:], fit.matrix, fit.distortion)[1]
    own, camera = jacobian[:, :6], jacobian[:, _COLUMNS]
    inverse = np.linalg.pinv(own.T @ own, hermitian=True)
    follows = -inverse @ own.T @ camera
    joint = np.zeros((15, 15))
    joint[:9, :9] = fit.covariance
    joint[9:, :9] = follows @ fit.covariance
    joint[:9, 9:] = joint[9:, :9].T
    joint[9:, 9:] = follows @ fit.covariance @ follows.T + fit.corner_variance * inverse
    return joint
