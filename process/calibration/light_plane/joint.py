"""Owns the joint solution of light plane, boards, stage and camera, with the covariance of all of it.

A small board near the middle of a nearly telecentric picture hardly shows its own tilt. But when the light passes each
board is known far better, and that ties their tilts to each other: everything is solved for together, each source with
its own weight. The mirrored pose of a board is tried where its corners allow it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from process.calibration.board.poses import Pose, find_pose
from process.calibration.camera.bundle import as_vector

from .edge_on_surface import light_again, light_on
from .joint_residuals import (
    INTRINSICS,
    POSE,
    Problem,
    Seen,
    State,
    camera_of,
    corner_rows,
    first_state,
    places_on,
    seat,
    seat_rows,
    seen_by,
    stacked,
)
from .joint_search import all_rows, apart_deg, best_of_mirrored, inverse_of, least_squares, rows_by_source
from .surfaces import Surface

F8 = NDArray[np.float64]
LEAST_CORNER_SD_PX = 0.01
"""However well the corners fit: what they have in common does not show in their scatter."""
FLAT_DEG = 3.0
"""A board that is tilted by more does not lie flat on the stage."""
CHANCE = 1.645
"""Standard deviations of a normal variable beyond which chance comes once in twenty times."""
LIES_FLAT = 25.0
"""Chi squared, of three, up to which a board is taken to lie flat."""


@dataclass(frozen=True)
class Moved:
    """By how much the solution moved a board from where its own corners put it."""

    um: float
    """RMS over three places on the board, along the light plane's normal."""
    chi2: float
    """The same in variances of its own pose, of six; chance seldom gives more than 25."""


@dataclass(frozen=True)
class Joint:
    """The solution."""

    problem: Problem
    state: State
    noise: dict[str, F8]
    """Covariance [n, n] of the state's vector by source: pixels, poses, camera."""
    moved: tuple[Moved | None, ...]
    """For each surface; None for those without a pose of their own."""
    contradiction: float
    """Chi squared per degree of freedom of what the sources say of each other; about 1 where all is well."""
    freedom: int

    @property
    def seen(self) -> Seen:
        """The camera and its stage."""
        return camera_of(self.problem, self.state)

    @property
    def camera(self) -> CameraModel:
        """The camera and its stage, for rays."""
        seen, given = self.seen, self.problem.camera
        own = {"K": seen.matrix.tolist(), "R": seen.turn.tolist(), "T": seen.shift.tolist()}
        fields = msgspec.to_builtins(given) | own | {"distortion": seen.lens.tolist()}
        return msgspec.convert(fields, CameraModel)

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """In the world, where the solution puts them."""
        return _placed(self.problem, self.state, self.seen)

    @property
    def heights(self) -> F8:
        """[surfaces] mm; 0 for boards."""
        found = np.zeros(len(self.problem.surfaces))
        found[list(self.problem.flats)] = self.state.heights
        return found

    @property
    def light(self) -> F8:
        """[4] a and b of t = a . X + b in the world."""
        return self.light_of(self.state)

    def light_of(self, state: State) -> F8:
        """The same of another state."""
        seen, (a, b) = camera_of(self.problem, state), (state.light[:3], state.light[3])
        return np.append(seen.turn.T @ a, b + a @ (seen.shift - self.problem.given[-3:]))

    def camera_and_light_of(self, state: State) -> F8:
        """[19] intrinsics, stage, a and b."""
        return np.concatenate([self.problem.given + self.problem.axes @ state.prior, self.light_of(state)])

    def covariance(self, source: str | None = None) -> F8:
        """[19, 19] of intrinsics, stage, and a and b in the world; from all sources, or one.

        Where the sources contradict each other, all of these are too small by as much.
        """
        own = sum(self.noise.values()) if source is None else self.noise[source]
        middle, by = self.state.vector(), []
        for step, unit in zip(self.state.steps(), np.eye(len(middle)), strict=True):
            there, back = (self.camera_and_light_of(self.state.of(middle + sign * step * unit)) for sign in (1, -1))
            by.append((there - back) / (2 * step))
        root = np.array(by)
        return np.asarray(root.T @ own @ root, dtype=np.float64) * (self.contradiction if self.contradicts else 1.0)

    @property
    def contradicts(self) -> bool:
        """The sources contradict each other by more than chance explains (Wilson and Hilferty's quantile)."""
        spread = 2 / (9 * self.freedom)
        return bool(self.contradiction > (1 - spread + CHANCE * np.sqrt(spread)) ** 3)


def solve_jointly(surfaces: Sequence[Surface], camera: CameraModel, known_camera: F8 | None) -> Joint:
    """Light plane, boards, stage and camera that explain crossings and corners together.

    Args:
        surfaces: at least two that are not in one plane.
        camera: with its pose in the world.
        known_camera: covariance [15, 15] of the camera's intrinsics and pose; None: both are taken as exact.

    Raises:
        CalibrationError: a board whose two poses explain everything nearly equally.
    """
    light = tuple(light_on(surface, camera) for surface in surfaces)
    problem = Problem(tuple(surfaces), light, camera, known_camera, _corner_sd_px(surfaces))
    state = best_of_mirrored(problem, *least_squares(problem, first_state(problem)))
    placed = _placed(problem, state, seen_by(problem.given))
    light = tuple(light_again(*each, camera) for each in zip(light, placed, strict=True))
    problem = replace(problem, light=light, lying=_lying(problem, state))
    return _finished(problem, least_squares(problem, state)[0])


def _placed(problem: Problem, state: State, seen: Seen) -> tuple[Surface, ...]:
    """The surfaces where the solution puts them, in the world of a camera."""
    found = list(problem.surfaces)
    for pose, index in zip(state.boards, problem.boards, strict=True):
        point, normal = seen.turn.T @ (pose[3:] - seen.shift), seen.turn.T @ cv2.Rodrigues(pose[:3])[0][:, 2]
        found[index] = replace(found[index], point=point, normal=normal)
    return tuple(found)


def _corner_sd_px(surfaces: Sequence[Surface]) -> float:
    """One board and one camera: the corners of all sweeps are equally good, whatever a single fit says by chance."""
    squares, freedom = 0.0, 0
    for surface in surfaces:
        if surface.sighting is not None and surface.pose is not None:
            squares += surface.pose.rms_px**2 * len(surface.sighting.pixels)
            freedom += 2 * len(surface.sighting.pixels) - POSE
    return max(float(np.sqrt(squares / max(freedom, 1))), LEAST_CORNER_SD_PX)


def _lying(problem: Problem, state: State) -> tuple[int, ...]:
    """Boards that lie flat on the stage as far as corners and light tell."""
    if not problem.axes[INTRINSICS:].any():
        return ()
    covariance, found = inverse_of(all_rows(problem, state).by), []
    for number, index in enumerate(problem.boards):
        by, off = seat_rows(replace(problem, lying=(index,)), state).by, seat(problem, state, number)
        chi2 = float(off @ np.linalg.solve(by @ covariance @ by.T + np.eye(3), off))
        tilt_deg = apart_deg(state.boards[number][:3], problem.given[INTRINSICS : INTRINSICS + 3])
        if tilt_deg < FLAT_DEG and chi2 < LIES_FLAT:
            found.append(index)
    return tuple(found)


def _finished(problem: Problem, state: State) -> Joint:
    parts = rows_by_source(problem, state)
    inverse = inverse_of(stacked(list(parts.values())).by)
    roots = {name: inverse @ part.by.T for name, part in parts.items()}
    moved = tuple(_moved(problem, state, index) for index in range(len(problem.surfaces)))
    rest = stacked([parts["pixels"], parts["camera"], seat_rows(problem, state)]).residual
    chi2 = float(rest @ rest) + sum(one.chi2 for one in moved if one is not None)
    freedom = 3 * (len(problem.surfaces) + len(problem.lying)) - len(problem.flats) - 4
    noise = {name: root @ root.T for name, root in roots.items()}
    return Joint(problem, state, noise, moved, chi2 / max(freedom, 1), max(freedom, 1))


def _moved(problem: Problem, state: State, index: int) -> Moved | None:
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
    return Moved(float(np.sqrt((um**2).mean())), float(step @ step))


def _own_pose(surface: Surface, seen: Seen, near: F8) -> F8:
    """Where a board's own corners put it: of its two poses that which the solution has."""
    assert surface.sighting is not None
    found: Pose | None = find_pose(surface.sighting.object_mm, surface.sighting.pixels, seen.matrix, seen.lens)
    assert found is not None
    poses = [found, *([found.other] if found.other is not None else [])]
    nearest = as_vector(min(poses, key=lambda pose: apart_deg(pose.rotation_vector, near[:3])))
    other_way = np.concatenate([nearest[:3] * (1 - 2 * np.pi / np.linalg.norm(nearest[:3])), nearest[3:]])
    return nearest if np.linalg.norm(nearest - near) < np.linalg.norm(other_way - near) else other_way
