"""Owns the equations that tie camera, stage, boards and light together: residuals in standard deviations.

Unknown are the camera's intrinsics and the stage's pose (as far as the board views left them open), each board's pose,
each flat's height, and t = a . (X - X0) + b, all in camera coordinates. Known are when the light passes each surface,
where the board's corners are seen, and which boards lie flat on the stage.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from process.calibration.camera.bundle import as_vector

from .edge_on_surface import LightOn
from .surfaces import Surface

F8 = NDArray[np.float64]
INTRINSICS = 9
POSE = 6
SEAT_MM, SEAT_RAD = 0.001, float(np.radians(0.01))
"""How well a board that is laid on the stage once more lies in the same plane (standard deviations)."""
LEAST_AXIS = 1e-11
"""Axes of the camera's covariance (as correlations) with less than this are no freedom."""
_POSE_STEPS = np.array([1e-6, 1e-6, 1e-6, 1e-5, 1e-5, 1e-5])
_PRIOR_STEP = 1e-3
_UNDISTORT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-12)


@dataclass(frozen=True)
class Problem:
    """All that is known."""

    surfaces: tuple[Surface, ...]
    light: tuple[LightOn, ...]
    camera: CameraModel
    known_camera: F8 | None
    """Covariance [15, 15] of intrinsics and stage; None: both are exact."""
    corner_sd_px: float
    """Of one coordinate of a corner."""
    lying: tuple[int, ...] = ()
    """Surfaces that are boards lying flat on the stage."""

    @cached_property
    def given(self) -> F8:
        """[15] as the camera's file has it: fx fy cx cy k1 k2 p1 p2 k3, the stage's rotation vector and translation."""
        matrix, turn = np.array(self.camera.K), cv2.Rodrigues(np.array(self.camera.R))[0].ravel()
        optics = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *self.camera.distortion]
        return np.concatenate([optics, turn, np.array(self.camera.T)])

    @cached_property
    def axes(self) -> F8:
        """[15, k] one standard deviation along each independent axis of what is not known of these."""
        if self.known_camera is None:
            return np.zeros((INTRINSICS + POSE, 0))
        size = np.sqrt(np.maximum(np.diag(self.known_camera), 0.0))
        unit = np.where(size > 0, size, 1.0)
        values, vectors = np.linalg.eigh(self.known_camera / np.outer(unit, unit))
        kept = values > LEAST_AXIS * max(float(values[-1]), 1e-300)
        return np.asarray(unit[:, None] * vectors[:, kept] * np.sqrt(values[kept]), dtype=np.float64)

    @cached_property
    def boards(self) -> tuple[int, ...]:
        """Surfaces whose pose is unknown."""
        return tuple(index for index, s in enumerate(self.surfaces) if s.sighting is not None and s.pose is not None)

    @cached_property
    def flats(self) -> tuple[int, ...]:
        """Surfaces whose height is unknown."""
        return tuple(index for index, s in enumerate(self.surfaces) if s.free_height)


@dataclass(frozen=True)
class State:
    """Values of the unknowns, and how they lie in one vector: camera and stage, boards, heights, a and b."""

    prior: F8
    """[k] along Problem.axes."""
    boards: F8
    """[boards, 6] rotation vector, translation."""
    heights: F8
    """[flats] mm."""
    light: F8
    """[4] a in t per mm, and b."""

    def vector(self) -> F8:
        """All in one, [n]."""
        return np.concatenate([self.prior, self.boards.ravel(), self.heights, self.light])

    def of(self, vector: F8) -> State:
        """The state with other values."""
        ends = np.cumsum([self.prior.size, self.boards.size, self.heights.size])
        prior, boards, heights, light = np.split(vector, ends)
        return State(prior, boards.reshape(-1, POSE), heights, light)

    def columns(self, board: int) -> slice:
        """Where a board's pose lies in the vector."""
        first = self.prior.size + POSE * board
        return slice(first, first + POSE)

    def steps(self) -> F8:
        """[n] small changes, for differences."""
        poses, size = np.tile(_POSE_STEPS, len(self.boards)), float(np.linalg.norm(self.light[:3]))
        prior, heights = np.full(self.prior.size, _PRIOR_STEP), np.full(self.heights.size, 1e-5)
        return np.concatenate([prior, poses, heights, np.full(3, 1e-6 * size), [1e-5 * size]])


@dataclass(frozen=True)
class Seen:
    """The camera of a state."""

    matrix: F8
    lens: F8
    turn: F8
    """[3, 3] of the stage."""
    shift: F8
    """[3] of the stage."""


def seen_by(values: F8) -> Seen:
    """Of intrinsics and stage, [15]."""
    fx, fy, cx, cy = values[:4]
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    turn = np.asarray(cv2.Rodrigues(values[INTRINSICS : INTRINSICS + 3])[0], dtype=np.float64)
    return Seen(matrix, values[4:INTRINSICS], turn, values[INTRINSICS + 3 :])


def camera_of(problem: Problem, state: State) -> Seen:
    """The camera where the state puts it."""
    return seen_by(problem.given + problem.axes @ state.prior)


@dataclass(frozen=True)
class Rows:
    """Residuals in standard deviations [m], and their derivatives by the state's vector [m, n]."""

    residual: F8
    by: F8


def light_rows(problem: Problem, state: State) -> Rows:
    """When the light passes each surface."""
    roots = [np.linalg.inv(np.linalg.cholesky(seen.covariance)) for seen in problem.light]

    def residual(values: State) -> F8:
        from_origin = places_on(problem, values) - problem.given[-3:]
        predicted = from_origin @ values.light[:3] + values.light[3]
        parts = zip(roots, problem.light, predicted, strict=True)
        return np.concatenate([root @ (t - seen.t) for root, seen, t in parts])

    return _differentiated(residual, state)


def seat_rows(problem: Problem, state: State) -> Rows:
    """Boards that lie flat lie in z = 0: two tilts and the height of each."""

    def residual(values: State) -> F8:
        parts = [seat(problem, values, problem.boards.index(index)) for index in problem.lying]
        return np.concatenate([np.zeros(0), *parts])

    return _differentiated(residual, state)


def seat(problem: Problem, state: State, board: int) -> F8:
    """[3] tilts and height of a board (its number among the boards) against z = 0, in units of how well it lies."""
    camera, pose = camera_of(problem, state), state.boards[board]
    normal = camera.turn.T @ cv2.Rodrigues(pose[:3])[0][:, 2]
    height = (camera.turn.T @ (pose[3:] - camera.shift))[2]
    return np.array([normal[0] / SEAT_RAD, normal[1] / SEAT_RAD, height / SEAT_MM])


def prior_rows(state: State) -> Rows:
    """What the board views said of camera and stage."""
    by = np.zeros((state.prior.size, len(state.vector())))
    by[:, : state.prior.size] = np.eye(state.prior.size)
    return Rows(state.prior, by)


def corner_rows(problem: Problem, state: State, surface: int) -> Rows:
    """Where the corners of one board are seen."""
    board, camera = problem.boards.index(surface), camera_of(problem, state)
    view, pose = problem.surfaces[surface].sighting, state.boards[board]
    assert view is not None
    pixels, jacobian = cv2.projectPoints(view.object_mm, pose[:3], pose[3:], camera.matrix, camera.lens)[:2]
    by = np.zeros((2 * len(view.pixels), len(state.vector())))
    by[:, : state.prior.size] = jacobian[:, POSE : POSE + INTRINSICS] @ problem.axes[:INTRINSICS]
    by[:, state.columns(board)] = jacobian[:, :POSE]
    residual = np.asarray(pixels, dtype=np.float64).ravel() - view.pixels.ravel()
    return Rows(residual / problem.corner_sd_px, by / problem.corner_sd_px)


def stacked(parts: Sequence[Rows]) -> Rows:
    """All of them, one after the other."""
    return Rows(np.concatenate([part.residual for part in parts]), np.concatenate([part.by for part in parts]))


def places_on(problem: Problem, state: State) -> F8:
    """[surfaces, 3, 3] mm in camera coordinates: where the rays of each surface's three places meet it."""
    camera = camera_of(problem, state)
    places = np.concatenate([seen.places for seen in problem.light]).reshape(-1, 1, 2)
    flat = cv2.undistortPoints(places, camera.matrix, camera.lens, criteria=_UNDISTORT).reshape(-1, 2)
    rays = np.column_stack([flat, np.ones(len(flat))]).reshape(-1, 3, 3)
    planes = [_plane(problem, state, camera, index) for index in range(len(problem.surfaces))]
    found = [(n @ at / (ray @ n))[:, None] * ray for ray, (n, at) in zip(rays, planes, strict=True)]
    return np.array(found, dtype=np.float64)


def _plane(problem: Problem, state: State, camera: Seen, index: int) -> tuple[F8, F8]:
    """Normal and a point of a surface, in camera coordinates."""
    if index in problem.boards:
        pose = state.boards[problem.boards.index(index)]
        return cv2.Rodrigues(pose[:3])[0][:, 2], pose[3:]
    surface = problem.surfaces[index]
    height = float(state.heights[problem.flats.index(index)]) if surface.free_height else 0.0
    return camera.turn @ surface.normal, camera.turn @ (surface.point + height * surface.normal) + camera.shift


def first_state(problem: Problem) -> State:
    """Boards where their own corners put them, the light where these put it."""
    poses = [problem.surfaces[index].pose for index in problem.boards]
    boards = np.array([as_vector(pose) for pose in poses if pose is not None]).reshape(-1, POSE)
    none = np.zeros(problem.axes.shape[1])
    return lit(problem, State(none, boards, np.zeros(len(problem.flats)), np.zeros(4)))


def lit(problem: Problem, state: State) -> State:
    """The state with the light that its surfaces imply; flats of unknown height have no say."""
    known = [index for index in range(len(problem.surfaces)) if index not in problem.flats]
    x = (places_on(problem, state)[known] - problem.given[-3:]).reshape(-1, 3)
    t = np.concatenate([problem.light[index].t for index in known])
    light = np.linalg.lstsq(np.column_stack([x, np.ones(len(x))]), t, rcond=None)[0]
    return State(state.prior, state.boards, state.heights, np.asarray(light, dtype=np.float64))


def _differentiated(residual: Callable[[State], F8], state: State) -> Rows:
    """Derivatives by central differences."""
    middle, value = state.vector(), residual(state)
    by = np.zeros((len(value), len(middle)))
    if len(value):
        for column, step in enumerate(state.steps()):
            change = np.zeros(len(middle))
            change[column] = step
            by[:, column] = (residual(state.of(middle + change)) - residual(state.of(middle - change))) / (2 * step)
    return Rows(value, by)
