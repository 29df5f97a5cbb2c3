"""Which of the mirrored poses of the boards are taken, and when none can be: synthetic sweeps of known poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from acquire.contract.errors import CalibrationError
from process.calibration.board.poses import TELL_APART
from process.calibration.light_plane.from_sweeps import PlaneResult, fit_plane
from process.calibration.light_plane.joint_search import best_and_rivals
from process.calibration.light_plane.surfaces import Surface
from tests.accuracy.uncertainty import SMALL, measured
from tests.unit.process.calibration.light_plane.test_joint import mirrored

FLAT_AND_TILTED = ((0, 0), (10, 0))


def fitted(surfaces: list[Surface], camera, known) -> PlaneResult:
    return fit_plane(surfaces, camera, edge="rising", method="auto", known_camera=known)


def apart(one: PlaneResult, other: PlaneResult) -> float:
    """Distance of two light planes in standard deviations of the first."""
    return float(np.linalg.norm(one.a - other.a) / np.sqrt(np.trace(one.spread.total[:3, :3])))


def with_one_pose(surface: Surface) -> Surface:
    """The surface without the mirrored pose of its board."""
    assert surface.pose is not None
    return replace(surface, pose=replace(surface.pose, other=None))


State = tuple[bool, bool]
OWN, FIRST, SECOND, BOTH = (False, False), (True, False), (False, True), (True, True)
"""Which of two boards are in their mirrored pose."""


def search(costs: dict[State, float]) -> tuple[State, list[float]]:
    """The best of solutions with these costs, and by how much the others are worse."""

    def solve(state: State, flipped: tuple[int, ...]) -> tuple[State, float]:
        found = (state[0] != (0 in flipped), state[1] != (1 in flipped))
        return found, costs[found]

    best, cost, rivals = best_and_rivals(OWN, costs[OWN], [(0,), (1,), (0, 1)], solve)
    return best, [rival_cost - cost for _, rival_cost in rivals]


def test_two_solutions_that_are_nearly_equal_do_not_hinder_a_third_that_is_far_better():
    near = 1000.0 - TELL_APART / 2
    best, worse_by = search({OWN: 1000.0, FIRST: near, SECOND: 10.0, BOTH: 10.0 + 2 * TELL_APART})
    assert best == SECOND
    assert min(worse_by) == 2 * TELL_APART


def test_a_solution_nearly_as_good_as_the_best_is_among_its_rivals():
    best, worse_by = search({OWN: 1000.0, FIRST: 990.0, SECOND: 10.0, BOTH: 10.0 + TELL_APART / 2})
    assert best == SECOND
    assert min(worse_by) == TELL_APART / 2


@pytest.fixture(scope="module")
def blurred():
    """Sweeps over the flat and the tilted board whose corners say little of the tilt: the light decides."""
    return measured(replace(SMALL, corner_noise_px=0.15, sweeps=FLAT_AND_TILTED), 3)


def test_a_board_taken_for_its_mirrored_pose_is_turned_over(blurred):
    (flat, tilted), camera, known = blurred
    right = fitted([flat, tilted], camera, known)
    assert apart(right, fitted([flat, mirrored(tilted, camera)], camera, known)) < 0.1


def test_boards_that_lie_right_are_left_as_they_are(blurred):
    surfaces, camera, known = blurred
    sure = [with_one_pose(surface) for surface in surfaces]
    assert apart(fitted(sure, camera, known), fitted(surfaces, camera, known)) < 0.1


def test_a_board_whose_two_poses_explain_light_and_corners_nearly_equally_is_refused_by_name():
    surfaces, camera, known = measured(replace(SMALL, corner_noise_px=0.6, sweeps=FLAT_AND_TILTED), 5)
    flat, tilted = (
        replace(surface, sweep=replace(surface.sweep, name=name))
        for surface, name in zip(surfaces, ("flat", "tilted"), strict=True)
    )
    with pytest.raises(CalibrationError, match="^tilted: two poses of the board explain it nearly equally"):
        fitted([with_one_pose(flat), tilted], camera, known)
