"""Owns the search for the joint solution: least squares from a start, and from the mirrored poses of the boards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError
from process.calibration.board.poses import TELL_APART, Pose
from process.calibration.camera.bundle import as_vector

from .joint_residuals import Problem, Rows, State, corner_rows, light_rows, lit, prior_rows, seat_rows, stacked

F8 = NDArray[np.float64]
ROUNDS = 60
CONVERGED = 1e-4
"""Of the sum of squares: a hundredth of a standard deviation."""
LEAST_DAMPING = 1e-12
"""Of the scaled normal matrix: small, since the principal point is a long valley that all tilts follow."""
HOPELESS = 8 * TELL_APART
"""A mirrored pose that the corners contradict by so much is not tried."""
BACK_SHARE = 0.3
"""A board that was turned over and ends within this share of the way has come back: there is one solution."""


def inverse_of(by: F8) -> F8:
    """Inverse of the normal matrix of rows, scaled."""
    unit = 1 / np.maximum(np.linalg.norm(by, axis=0), 1e-300)
    return np.asarray(np.linalg.pinv((by * unit).T @ (by * unit), 1e-14, hermitian=True) * np.outer(unit, unit))


def rows_by_source(problem: Problem, state: State) -> dict[str, Rows]:
    """All equations by source."""
    corners = [corner_rows(problem, state, index) for index in problem.boards]
    poses = stacked([*corners, seat_rows(problem, state)])
    return {"pixels": light_rows(problem, state), "poses": poses, "camera": prior_rows(state)}


def all_rows(problem: Problem, state: State) -> Rows:
    """All equations."""
    return stacked(list(rows_by_source(problem, state).values()))


def least_squares(problem: Problem, state: State) -> tuple[State, float]:
    """Levenberg-Marquardt; the state and its sum of squares."""
    rows, damping = all_rows(problem, state), LEAST_DAMPING
    cost = float(rows.residual @ rows.residual)
    for _ in range(ROUNDS):
        unit = 1 / np.maximum(np.linalg.norm(rows.by, axis=0), 1e-300)
        scaled = rows.by * unit
        inner = scaled.T @ scaled + damping * np.eye(len(unit))
        step = -unit * np.linalg.lstsq(inner, scaled.T @ rows.residual, rcond=None)[0]
        moved = state.of(state.vector() + step)
        moved_rows = all_rows(problem, moved)
        new_cost = float(moved_rows.residual @ moved_rows.residual)
        if not new_cost <= cost:
            damping *= 10
            if damping > 1e6:
                break
            continue
        done = cost - new_cost < CONVERGED
        state, rows, cost, damping = moved, moved_rows, new_cost, max(damping / 10, LEAST_DAMPING)
        if done:
            break
    return state, cost


def best_of_mirrored(problem: Problem, state: State, cost: float) -> State:
    """Each board turned over to its mirrored pose, and all of them together, where their corners allow that.

    Raises:
        CalibrationError: another solution explains everything nearly as well as the best one.
    """
    every = tuple(range(len(problem.boards)))
    turns = [
        turned
        for turned in dict.fromkeys([*((number,) for number in every), every])
        if sum(_excess(problem, number) for number in turned) <= HOPELESS
    ]
    rivals: list[tuple[float, State]] = []
    left = list(turns)
    while left:
        turned = left.pop(0)
        again, new_cost = least_squares(problem, lit(problem, _turned_over(problem, state, turned)))
        if all(_came_back(problem, state, again, number) for number in turned):
            continue
        if new_cost < cost - TELL_APART:
            # whatever was nearly equal to a solution that is no good says nothing: all are turned over from the better
            state, cost, left = again, new_cost, list(turns)
        else:
            rivals.append((new_cost, again))
    _tell_apart(problem, state, cost, rivals)
    return state


def _tell_apart(problem: Problem, best: State, cost: float, rivals: Sequence[tuple[float, State]]) -> None:
    for rival_cost, rival in rivals:
        differing = [number for number in _mirrorable(problem) if not _came_back(problem, best, rival, number)]
        if differing and rival_cost - cost < TELL_APART:
            names = ", ".join(problem.surfaces[problem.boards[number]].sweep.name for number in differing)
            raise CalibrationError(
                f"{names}: two poses of the board explain it nearly equally, with the light as well; tilt it more"
            )


def _mirrorable(problem: Problem) -> list[int]:
    return [number for number in range(len(problem.boards)) if _poses(problem, number)[1] is not None]


def _poses(problem: Problem, number: int) -> tuple[Pose, Pose | None]:
    """Of a board: as its corners have it, and mirrored."""
    pose = problem.surfaces[problem.boards[number]].pose
    assert pose is not None
    return pose, pose.other


def _excess(problem: Problem, number: int) -> float:
    """By how much the corners alone speak against the mirrored pose, in variances."""
    own, other = _poses(problem, number)
    view = problem.surfaces[problem.boards[number]].sighting
    if other is None or view is None:
        return float("inf")
    return len(view.pixels) * (other.rms_px**2 - own.rms_px**2) / problem.corner_sd_px**2


def _turned_over(problem: Problem, state: State, turned: Sequence[int]) -> State:
    """These boards in that of their two poses which they do not have."""
    boards = state.boards.copy()
    for number in turned:
        own, other = _poses(problem, number)
        assert other is not None
        now = state.boards[number][:3]
        over = apart_deg(now, other.rotation_vector) < apart_deg(now, own.rotation_vector)
        boards[number] = as_vector(own if over else other)
    return replace(state, boards=boards)


def _came_back(problem: Problem, before: State, after: State, number: int) -> bool:
    own, other = _poses(problem, number)
    assert other is not None
    way = apart_deg(own.rotation_vector, other.rotation_vector)
    return apart_deg(after.boards[number][:3], before.boards[number][:3]) < BACK_SHARE * way


def apart_deg(first: F8, second: F8) -> float:
    """Angle between the normals of two rotation vectors."""
    one, other = (cv2.Rodrigues(np.ascontiguousarray(turn))[0][:, 2] for turn in (first, second))
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), abs(float(one @ other)))))
