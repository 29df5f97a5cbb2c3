"""Search for the joint solution: least squares from a start, and again from the mirrored poses of the boards.

A board seen from far away has two poses that project to nearly the same corners (see ``board.poses``). Costs are sums
of squares in standard deviations, so differences of costs are chi squared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError
from process.calibration.board.poses import TELL_APART, PlanePose
from process.calibration.camera.bundle import as_vector

from .joint_residuals import (
    JointProblem,
    JointState,
    ResidualRows,
    corner_rows,
    flat_board_rows,
    light_rows,
    prior_rows,
    stacked,
    with_implied_light,
)

F8 = NDArray[np.float64]
Boards = tuple[int, ...]
"""Numbers of boards."""
Solution = TypeVar("Solution")
Found: TypeAlias = tuple[Solution, float]
"""A solution and its sum of squares."""
ROUNDS = 60
CONVERGED = 1e-4
"""Change of the sum of squares that ends the iteration: a hundredth of a standard deviation."""
LEAST_DAMPING = 1e-12
"""Of the scaled normal matrix; small, since the cost is a long flat valley along the principal point and all tilts."""
MAX_MIRROR_CHI2 = 8 * TELL_APART
"""A mirrored pose that the corners alone contradict by more is not tried."""
SAME_POSE_SHARE = 0.3
"""A mirrored board that ends within this share of the angle between its poses from where it was has the same pose."""


def inverse_of(by: F8) -> F8:
    """Inverse of the normal matrix of rows [m, n]: the covariance [n, n] of the state."""
    # columns scaled to unit length: px, rad, mm and t differ by orders of magnitude
    unit = 1 / np.maximum(np.linalg.norm(by, axis=0), 1e-300)
    return np.asarray(np.linalg.pinv((by * unit).T @ (by * unit), 1e-14, hermitian=True) * np.outer(unit, unit))


def rows_by_source(problem: JointProblem, state: JointState) -> dict[str, ResidualRows]:
    """All residuals by source."""
    corners = [corner_rows(problem, state, index) for index in problem.boards]
    poses = stacked([*corners, flat_board_rows(problem, state)])
    return {"pixels": light_rows(problem, state), "poses": poses, "camera": prior_rows(state)}


def all_rows(problem: JointProblem, state: JointState) -> ResidualRows:
    """All residuals."""
    return stacked(list(rows_by_source(problem, state).values()))


def least_squares(problem: JointProblem, state: JointState) -> tuple[JointState, float]:
    """Levenberg-Marquardt iteration; returns the state and its sum of squares."""
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


def search_mirrored_poses(problem: JointProblem, state: JointState, cost: float) -> JointState:
    """The best solution over the mirrored poses: of each board alone and of all together, where their corners allow it.

    Raises:
        CalibrationError: a solution with other poses explains everything nearly as well as the best one.
    """

    def solve(start: JointState, flipped: Boards) -> tuple[JointState, float] | None:
        found, new_cost = least_squares(problem, with_implied_light(problem, _mirrored_state(problem, start, flipped)))
        came_back = all(_same_pose(problem, start, found, number) for number in flipped)
        return None if came_back else (found, new_cost)

    every = tuple(range(len(problem.boards)))
    flips = [
        flipped
        for flipped in dict.fromkeys([*((number,) for number in every), every])
        if sum(_mirror_chi2(problem, number) for number in flipped) <= MAX_MIRROR_CHI2
    ]
    best, cost, rivals = best_and_rivals(state, cost, flips, solve)
    _refuse_ambiguous(problem, best, cost, rivals)
    return best


def best_and_rivals(
    start: Solution, cost: float, flips: Sequence[Boards], solve: Callable[[Solution, Boards], Found[Solution] | None]
) -> tuple[Solution, float, list[Found[Solution]]]:
    """The best solution that flips lead to, its cost, and the other solutions found with their costs.

    Args:
        start: a solution.
        cost: its sum of squares.
        flips: sets of boards to put into their other pose.
        solve: the solution from ``start`` with some boards flipped, and its cost; None if it came back to ``start``.
    """
    best, rivals, left = start, [], list(flips)
    while left:
        found = solve(best, left.pop(0))
        if found is None:
            continue
        if found[1] < cost - TELL_APART:
            # Start again from the better solution. Rivals are compared with the best one only at the end: two bad
            # solutions that are nearly equal mean nothing.
            (best, cost), left = found, list(flips)
        else:
            rivals.append(found)
    return best, cost, rivals


def _refuse_ambiguous(
    problem: JointProblem, best: JointState, cost: float, rivals: Sequence[tuple[JointState, float]]
) -> None:
    for rival, rival_cost in rivals:
        differing = [number for number in _mirrorable(problem) if not _same_pose(problem, best, rival, number)]
        if differing and rival_cost - cost < TELL_APART:
            names = ", ".join(problem.surfaces[problem.boards[number]].sweep.name for number in differing)
            raise CalibrationError(
                f"{names}: two poses of the board explain it nearly equally, with the light as well; tilt it more"
            )


def _mirrorable(problem: JointProblem) -> list[int]:
    return [number for number in range(len(problem.boards)) if _poses(problem, number)[1] is not None]


def _poses(problem: JointProblem, number: int) -> tuple[PlanePose, PlanePose | None]:
    """Of a board: the pose that fits its corners better, and the mirrored one."""
    pose = problem.surfaces[problem.boards[number]].pose
    assert pose is not None
    return pose, pose.other


def _mirror_chi2(problem: JointProblem, number: int) -> float:
    """Chi squared by which the corners alone contradict the mirrored pose."""
    own, other = _poses(problem, number)
    view = problem.surfaces[problem.boards[number]].sighting
    if other is None or view is None:
        return float("inf")
    return len(view.pixels) * (other.rms_px**2 - own.rms_px**2) / problem.corner_sd_px**2


def _mirrored_state(problem: JointProblem, state: JointState, flipped: Sequence[int]) -> JointState:
    """The state with these boards in the other one of their two poses."""
    boards = state.boards.copy()
    for number in flipped:
        own, other = _poses(problem, number)
        assert other is not None
        now = state.boards[number][:3]
        is_mirrored = apart_deg(now, other.rotation_vector) < apart_deg(now, own.rotation_vector)
        boards[number] = as_vector(own if is_mirrored else other)
    return replace(state, boards=boards)


def _same_pose(problem: JointProblem, before: JointState, after: JointState, number: int) -> bool:
    """Whether a board has the same one of its two poses in both states."""
    own, other = _poses(problem, number)
    assert other is not None
    way = apart_deg(own.rotation_vector, other.rotation_vector)
    return apart_deg(after.boards[number][:3], before.boards[number][:3]) < SAME_POSE_SHARE * way


def apart_deg(first: F8, second: F8) -> float:
    """Angle between the normals of two rotation vectors."""
    one, other = (cv2.Rodrigues(np.ascontiguousarray(turn))[0][:, 2] for turn in (first, second))
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), abs(float(one @ other)))))
