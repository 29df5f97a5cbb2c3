"""Joint solution of light plane, boards, stage and camera by least squares, with its covariance.

A small board near the middle of a nearly telecentric picture hardly shows its own tilt. But the time at which the light
passes each board is known far better, and it ties the tilts to each other: everything is solved for together, each
source with its own weight. Mirrored poses of a board are tried where its corners allow them. Lengths in mm, t in the
unit of the sweeps, float64.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from process.calibration.board.poses import find_pose
from process.calibration.camera.bundle import as_vector

from .edge_on_surface import light_passage, light_passage_again
from .joint_residuals import (
    INTRINSICS,
    POSE,
    CameraState,
    JointProblem,
    JointState,
    camera_of,
    camera_state,
    central_differences,
    corner_rows,
    first_state,
    flat_board_offset,
    flat_board_rows,
    places_on,
    stacked,
)
from .joint_search import all_rows, apart_deg, inverse_of, least_squares, rows_by_source, search_mirrored_poses
from .surfaces import Surface

F8 = NDArray[np.float64]
LEAST_CORNER_SD_PX = 0.01
"""However well the corners fit: an error that they have in common does not show in their scatter."""
FLAT_DEG = 3.0
"""A board that is tilted by more does not lie flat on the stage."""
CHANCE = 1.645
"""Standard deviations that a normal variable exceeds once in twenty times."""
MAX_FLAT_CHI2 = 25.0
"""Chi squared (3 degrees of freedom) up to which a board is taken to lie flat."""


@dataclass(frozen=True)
class BoardShift:
    """Displacement of a board by the joint solution from the pose of its own corners."""

    um: float
    """RMS over three places on the board, along the light plane's normal."""
    chi2: float
    """The same as chi squared (6 degrees of freedom) of its own pose; chance seldom gives more than 25."""


@dataclass(frozen=True)
class Joint:
    """The joint solution."""

    problem: JointProblem
    state: JointState
    noise: dict[str, F8]
    """Covariance [n, n] of the state's vector by source: pixels, poses, camera."""
    shifts: tuple[BoardShift | None, ...]
    """For each surface; None for those without a pose of their own."""
    contradiction: float
    """Chi squared per degree of freedom between the sources; about 1 where they agree."""
    freedom: int
    """Degrees of freedom of that."""

    @property
    def camera_state(self) -> CameraState:
        """Camera and stage of the solution."""
        return camera_of(self.problem, self.state)

    @property
    def camera(self) -> CameraModel:
        """Camera and stage of the solution, for rays."""
        seen, given = self.camera_state, self.problem.camera
        own = {"K": seen.matrix.tolist(), "R": seen.rotation.tolist(), "T": seen.translation.tolist()}
        fields = msgspec.to_builtins(given) | own | {"distortion": seen.distortion.tolist()}
        return msgspec.convert(fields, CameraModel)

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """The surfaces in the world, where the solution puts them."""
        return _placed(self.problem, self.state, self.camera_state)

    @property
    def heights(self) -> F8:
        """[surfaces] height of each flat in mm; 0 for boards."""
        found = np.zeros(len(self.problem.surfaces))
        found[list(self.problem.flats)] = self.state.heights
        return found

    @property
    def light(self) -> F8:
        """[4] a and b of t = a . X + b, X in the world."""
        return self.light_of(self.state)

    def light_of(self, state: JointState) -> F8:
        """The same of another state."""
        # X_cam = R X + T (equation 1) inserted into t = a . (X_cam - X0) + b
        seen, (a, b) = camera_of(self.problem, state), (state.light[:3], state.light[3])
        return np.append(seen.rotation.T @ a, b + a @ (seen.translation - self.problem.given[-3:]))

    def camera_and_light_of(self, state: JointState) -> F8:
        """[19] intrinsics, stage, a, b."""
        return np.concatenate([self.problem.given + self.problem.axes @ state.prior, self.light_of(state)])

    def covariance(self, source: str | None = None) -> F8:
        """[19, 19] of intrinsics, stage, and a, b in the world; from all sources, or from one.

        It is enlarged where the sources contradict each other.
        """
        own = sum(self.noise.values()) if source is None else self.noise[source]
        root = central_differences(
            lambda values: self.camera_and_light_of(self.state.of(values)), self.state.vector(), self.state.steps()
        )
        return np.asarray(root.T @ own @ root, dtype=np.float64) * (self.contradiction if self.contradicts else 1.0)

    @property
    def contradicts(self) -> bool:
        """True if the sources contradict each other beyond chance (Wilson and Hilferty's quantile of chi squared)."""
        spread = 2 / (9 * self.freedom)
        return bool(self.contradiction > (1 - spread + CHANCE * np.sqrt(spread)) ** 3)


def solve_jointly(surfaces: Sequence[Surface], camera: CameraModel, known_camera: F8 | None) -> Joint:
    """Solve for light plane, boards, stage and camera from crossings and corners together.

    Args:
        surfaces: at least two that are not in one plane.
        camera: with its pose in the world.
        known_camera: covariance [15, 15] of the camera's intrinsics and pose; None: both are taken as exact.

    Raises:
        CalibrationError: two poses of a board explain everything nearly equally.
    """
    light = tuple(light_passage(surface, camera) for surface in surfaces)
    problem = JointProblem(tuple(surfaces), light, camera, known_camera, _corner_sd_px(surfaces))
    state = search_mirrored_poses(problem, *least_squares(problem, first_state(problem)))
    # the poses are known now: the places at which the light is timed are found again, and which boards lie flat
    placed = _placed(problem, state, camera_state(problem.given))
    light = tuple(light_passage_again(*each, camera) for each in zip(light, placed, strict=True))
    problem = replace(problem, light=light, flat_boards=_flat_boards(problem, state))
    return _finished(problem, least_squares(problem, state)[0])


def _placed(problem: JointProblem, state: JointState, seen: CameraState) -> tuple[Surface, ...]:
    """The surfaces where a state puts them, in the world of a camera."""
    found = list(problem.surfaces)
    for pose, index in zip(state.boards, problem.boards, strict=True):
        point = seen.rotation.T @ (pose[3:] - seen.translation)
        normal = seen.rotation.T @ cv2.Rodrigues(pose[:3])[0][:, 2]
        found[index] = replace(found[index], point=point, normal=normal)
    return tuple(found)


def _corner_sd_px(surfaces: Sequence[Surface]) -> float:
    """Standard deviation of one coordinate of a corner, over all sweeps: a single fit may be good by chance."""
    squares, freedom = 0.0, 0
    for surface in surfaces:
        if surface.sighting is not None and surface.pose is not None:
            squares += surface.pose.rms_px**2 * len(surface.sighting.pixels)
            freedom += 2 * len(surface.sighting.pixels) - POSE
    return max(float(np.sqrt(squares / max(freedom, 1))), LEAST_CORNER_SD_PX)


def _flat_boards(problem: JointProblem, state: JointState) -> tuple[int, ...]:
    """Indices of the boards that lie flat on the stage as far as corners and light tell."""
    if not problem.axes[INTRINSICS:].any():
        return ()
    covariance, found = inverse_of(all_rows(problem, state).by), []
    for number, index in enumerate(problem.boards):
        by, off = (
            flat_board_rows(replace(problem, flat_boards=(index,)), state).by,
            flat_board_offset(problem, state, number),
        )
        chi2 = float(off @ np.linalg.solve(by @ covariance @ by.T + np.eye(3), off))
        tilt_deg = apart_deg(state.boards[number][:3], problem.given[INTRINSICS : INTRINSICS + 3])
        if tilt_deg < FLAT_DEG and chi2 < MAX_FLAT_CHI2:
            found.append(index)
    return tuple(found)


def _finished(problem: JointProblem, state: JointState) -> Joint:
    parts = rows_by_source(problem, state)
    inverse = inverse_of(stacked(list(parts.values())).by)
    roots = {name: inverse @ part.by.T for name, part in parts.items()}
    shifts = tuple(_board_shift(problem, state, index) for index in range(len(problem.surfaces)))
    rest = stacked([parts["pixels"], parts["camera"], flat_board_rows(problem, state)]).residual
    chi2 = float(rest @ rest) + sum(one.chi2 for one in shifts if one is not None)
    freedom = 3 * (len(problem.surfaces) + len(problem.flat_boards)) - len(problem.flats) - 4
    noise = {name: root @ root.T for name, root in roots.items()}
    return Joint(problem, state, noise, shifts, chi2 / max(freedom, 1), max(freedom, 1))


def _board_shift(problem: JointProblem, state: JointState, index: int) -> BoardShift | None:
    surface = problem.surfaces[index]
    if index not in problem.boards or surface.sighting is None:
        return None
    number, seen = problem.boards.index(index), camera_of(problem, state)
    boards = state.boards.copy()
    boards[number] = _own_pose(surface, seen, state.boards[number])
    alone = replace(state, boards=boards)
    step = corner_rows(problem, alone, index).by[:, state.columns(number)] @ (state.boards[number] - boards[number])
    change = (places_on(problem, state) - places_on(problem, alone))[index] @ state.light[:3]
    um = 1000 * change / float(np.linalg.norm(state.light[:3]))
    return BoardShift(float(np.sqrt((um**2).mean())), float(step @ step))


def _own_pose(surface: Surface, seen: CameraState, near: F8) -> F8:
    """Pose [6] of a board by its own corners alone, of the two the one that the solution has."""
    assert surface.sighting is not None
    found = find_pose(surface.sighting.object_mm, surface.sighting.pixels, seen.matrix, seen.distortion)
    poses = [found, *([found.other] if found.other is not None else [])]
    nearest = as_vector(min(poses, key=lambda pose: apart_deg(pose.rotation_vector, near[:3])))
    # a rotation vector and the one of 2 pi less about the opposite axis are the same pose
    other_way = np.concatenate([nearest[:3] * (1 - 2 * np.pi / np.linalg.norm(nearest[:3])), nearest[3:]])
    return nearest if np.linalg.norm(nearest - near) < np.linalg.norm(other_way - near) else other_way
