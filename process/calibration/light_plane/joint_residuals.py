"""Equations of the joint solution of camera, stage, boards and light plane: residuals in standard deviations.

Unknowns: the camera's intrinsics and the stage's pose (within their covariance from the board views), each board's
    pose, each flat's height, and the light plane t = a . (X - X0) + b, X and X0 in camera coordinates. Measured: when
    the light passes each surface, where the corners of each board are seen (equation 1 with lens distortion), and which
    boards lie flat on the stage. Lengths in mm, angles in rad, pixels in px, t in the unit of the sweeps; float64.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from process.calibration.camera.bundle import as_vector, camera_matrix

from .edge_on_surface import LightPassage
from .surfaces import Surface

F8 = NDArray[np.float64]
INTRINSICS = 9
POSE = 6
FLAT_BOARD_SD_MM, FLAT_BOARD_SD_RAD = 0.001, float(np.radians(0.01))
"""Standard deviations of height and tilt of a board that is laid flat on the stage again."""
LEAST_AXIS = 1e-11
"""Axes of the camera's correlation matrix with a smaller share of its largest eigenvalue are taken as exact."""
_POSE_STEPS = np.array([1e-6, 1e-6, 1e-6, 1e-5, 1e-5, 1e-5])
_PRIOR_STEP = 1e-3
_UNDISTORT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-12)


@dataclass(frozen=True)
class JointProblem:
    """The measurements, and what is known of the camera."""

    surfaces: tuple[Surface, ...]
    light: tuple[LightPassage, ...]
    camera: CameraModel
    known_camera: F8 | None
    """Covariance [15, 15] of intrinsics and stage; None: both are exact."""
    corner_sd_px: float
    """Of one coordinate of a corner."""
    flat_boards: tuple[int, ...] = ()
    """Indices of surfaces that are boards lying flat on the stage."""

    @cached_property
    def given(self) -> F8:
        """[15] from the camera's file: fx fy cx cy k1 k2 p1 p2 k3, then the stage's rotation vector and translation."""
        matrix, turn = np.array(self.camera.K), cv2.Rodrigues(np.array(self.camera.R))[0].ravel()
        optics = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *self.camera.distortion]
        return np.concatenate([optics, turn, np.array(self.camera.T)])

    @cached_property
    def axes(self) -> F8:
        """[15, k] principal axes of the covariance of ``given``, each one standard deviation long."""
        if self.known_camera is None:
            return np.zeros((INTRINSICS + POSE, 0))
        # of the correlations: px, rad and mm differ by orders of magnitude
        size = np.sqrt(np.maximum(np.diag(self.known_camera), 0.0))
        unit = np.where(size > 0, size, 1.0)
        values, vectors = np.linalg.eigh(self.known_camera / np.outer(unit, unit))
        kept = values > LEAST_AXIS * max(float(values[-1]), 1e-300)
        return np.asarray(unit[:, None] * vectors[:, kept] * np.sqrt(values[kept]), dtype=np.float64)

    @cached_property
    def boards(self) -> tuple[int, ...]:
        """Indices of surfaces whose pose is unknown."""
        return tuple(index for index, s in enumerate(self.surfaces) if s.sighting is not None and s.pose is not None)

    @cached_property
    def flats(self) -> tuple[int, ...]:
        """Indices of surfaces whose height is unknown."""
        return tuple(index for index, s in enumerate(self.surfaces) if s.free_height)


@dataclass(frozen=True)
class JointState:
    """Values of the unknowns; as a vector [n]: camera and stage, boards, heights, a, b."""

    prior: F8
    """[k] camera and stage, along JointProblem.axes."""
    boards: F8
    """[boards, 6] rotation vector, translation."""
    heights: F8
    """[flats] mm."""
    light: F8
    """[4] a in t per mm, and b."""

    def vector(self) -> F8:
        """All values, [n]."""
        return np.concatenate([self.prior, self.boards.ravel(), self.heights, self.light])

    def of(self, vector: F8) -> JointState:
        """The state with the values of a vector [n]."""
        ends = np.cumsum([self.prior.size, self.boards.size, self.heights.size])
        prior, boards, heights, light = np.split(vector, ends)
        return JointState(prior, boards.reshape(-1, POSE), heights, light)

    def columns(self, board: int) -> slice:
        """Elements of the vector that hold a board's pose."""
        first = self.prior.size + POSE * board
        return slice(first, first + POSE)

    def steps(self) -> F8:
        """[n] steps for numerical derivatives."""
        poses, size = np.tile(_POSE_STEPS, len(self.boards)), float(np.linalg.norm(self.light[:3]))
        prior, heights = np.full(self.prior.size, _PRIOR_STEP), np.full(self.heights.size, 1e-5)
        return np.concatenate([prior, poses, heights, np.full(3, 1e-6 * size), [1e-5 * size]])


@dataclass(frozen=True)
class CameraState:
    """Intrinsics of the camera and pose of the stage."""

    matrix: F8
    """K, [3, 3]."""
    distortion: F8
    """k1 k2 p1 p2 k3."""
    rotation: F8
    """R of equation 1, world to camera, [3, 3]."""
    translation: F8
    """T of equation 1, [3] mm."""


def camera_state(values: F8) -> CameraState:
    """From a vector [15] as JointProblem.given."""
    rotation = np.asarray(cv2.Rodrigues(values[INTRINSICS : INTRINSICS + 3])[0], dtype=np.float64)
    return CameraState(camera_matrix(values), values[4:INTRINSICS], rotation, values[INTRINSICS + 3 :])


def camera_of(problem: JointProblem, state: JointState) -> CameraState:
    """Camera and stage of a state."""
    return camera_state(problem.given + problem.axes @ state.prior)


@dataclass(frozen=True)
class ResidualRows:
    """Residuals in standard deviations [m], and their derivatives by the state's vector [m, n]."""

    residual: F8
    by: F8


def light_rows(problem: JointProblem, state: JointState) -> ResidualRows:
    """Residuals of when the light passes three places of each surface."""
    roots = [np.linalg.inv(np.linalg.cholesky(seen.covariance)) for seen in problem.light]

    def residual(values: JointState) -> F8:
        from_origin = places_on(problem, values) - problem.given[-3:]
        predicted = from_origin @ values.light[:3] + values.light[3]
        parts = zip(roots, problem.light, predicted, strict=True)
        return np.concatenate([root @ (t - seen.t) for root, seen, t in parts])

    return _differentiated(residual, state)


def flat_board_rows(problem: JointProblem, state: JointState) -> ResidualRows:
    """Residuals of boards that lie flat, in z = 0: two tilts and the height of each."""

    def residual(values: JointState) -> F8:
        parts = [flat_board_offset(problem, values, problem.boards.index(index)) for index in problem.flat_boards]
        return np.concatenate([np.zeros(0), *parts])

    return _differentiated(residual, state)


def flat_board_offset(problem: JointProblem, state: JointState, board: int) -> F8:
    """[3] tilts and height of a board (its number among the boards) against z = 0, in standard deviations."""
    camera, pose = camera_of(problem, state), state.boards[board]
    normal = camera.rotation.T @ cv2.Rodrigues(pose[:3])[0][:, 2]
    height = (camera.rotation.T @ (pose[3:] - camera.translation))[2]
    return np.array([normal[0] / FLAT_BOARD_SD_RAD, normal[1] / FLAT_BOARD_SD_RAD, height / FLAT_BOARD_SD_MM])


def prior_rows(state: JointState) -> ResidualRows:
    """Residuals of camera and stage against what the board views gave: standard normal along JointProblem.axes."""
    by = np.zeros((state.prior.size, len(state.vector())))
    by[:, : state.prior.size] = np.eye(state.prior.size)
    return ResidualRows(state.prior, by)


def corner_rows(problem: JointProblem, state: JointState, surface: int) -> ResidualRows:
    """Residuals of the corners of one board, with OpenCV's derivatives."""
    board, camera = problem.boards.index(surface), camera_of(problem, state)
    view, pose = problem.surfaces[surface].sighting, state.boards[board]
    assert view is not None
    pixels, jacobian = cv2.projectPoints(view.object_mm, pose[:3], pose[3:], camera.matrix, camera.distortion)[:2]
    by = np.zeros((2 * len(view.pixels), len(state.vector())))
    by[:, : state.prior.size] = jacobian[:, POSE : POSE + INTRINSICS] @ problem.axes[:INTRINSICS]
    by[:, state.columns(board)] = jacobian[:, :POSE]
    residual = np.asarray(pixels, dtype=np.float64).ravel() - view.pixels.ravel()
    return ResidualRows(residual / problem.corner_sd_px, by / problem.corner_sd_px)


def stacked(parts: Sequence[ResidualRows]) -> ResidualRows:
    """All rows, one part after the other."""
    return ResidualRows(np.concatenate([part.residual for part in parts]), np.concatenate([part.by for part in parts]))


def places_on(problem: JointProblem, state: JointState) -> F8:
    """[surfaces, 3, 3] mm in camera coordinates: where the rays of each surface's three places meet it (equation 4)."""
    camera = camera_of(problem, state)
    places = np.concatenate([seen.places for seen in problem.light]).reshape(-1, 1, 2)
    flat = cv2.undistortPoints(places, camera.matrix, camera.distortion, criteria=_UNDISTORT).reshape(-1, 2)
    rays = np.column_stack([flat, np.ones(len(flat))]).reshape(-1, 3, 3)
    planes = [_plane(problem, state, camera, index) for index in range(len(problem.surfaces))]
    found = [(n @ at / (ray @ n))[:, None] * ray for ray, (n, at) in zip(rays, planes, strict=True)]
    return np.array(found, dtype=np.float64)


def _plane(problem: JointProblem, state: JointState, camera: CameraState, index: int) -> tuple[F8, F8]:
    """Normal and a point of a surface, in camera coordinates."""
    if index in problem.boards:
        pose = state.boards[problem.boards.index(index)]
        return cv2.Rodrigues(pose[:3])[0][:, 2], pose[3:]
    surface = problem.surfaces[index]
    height = float(state.heights[problem.flats.index(index)]) if surface.free_height else 0.0
    return camera.rotation @ surface.normal, camera.rotation @ (
        surface.point + height * surface.normal
    ) + camera.translation


def first_state(problem: JointProblem) -> JointState:
    """Start: boards in the poses of their own corners, and the light plane that follows from these."""
    poses = [problem.surfaces[index].pose for index in problem.boards]
    boards = np.array([as_vector(pose) for pose in poses if pose is not None]).reshape(-1, POSE)
    none = np.zeros(problem.axes.shape[1])
    return with_implied_light(problem, JointState(none, boards, np.zeros(len(problem.flats)), np.zeros(4)))


def with_implied_light(problem: JointProblem, state: JointState) -> JointState:
    """The state with the light plane that its surfaces of known height imply, by linear least squares."""
    known = [index for index in range(len(problem.surfaces)) if index not in problem.flats]
    x = (places_on(problem, state)[known] - problem.given[-3:]).reshape(-1, 3)
    t = np.concatenate([problem.light[index].t for index in known])
    light = np.linalg.lstsq(np.column_stack([x, np.ones(len(x))]), t, rcond=None)[0]
    return JointState(state.prior, state.boards, state.heights, np.asarray(light, dtype=np.float64))


def central_differences(function: Callable[[F8], F8], at: F8, steps: F8) -> F8:
    """Derivatives [n, ...] of a function of a vector [n] by its elements, numerically."""
    changes = zip(steps, steps[:, None] * np.eye(len(steps)), strict=True)
    return np.array([(function(at + change) - function(at - change)) / (2 * step) for step, change in changes])


def _differentiated(residual: Callable[[JointState], F8], state: JointState) -> ResidualRows:
    by = central_differences(lambda values: residual(state.of(values)), state.vector(), state.steps())
    return ResidualRows(residual(state), by.T)
