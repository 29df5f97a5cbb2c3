"""Which of the mirrored solutions is taken, and when none is: costs are given, nothing is fitted."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from acquire.contract.errors import CalibrationError
from process.calibration.board.poses import TELL_APART
from process.calibration.light_plane import joint_search

State = tuple[bool, bool]
OWN, FIRST, SECOND, BOTH = (False, False), (True, False), (False, True), (True, True)
"""Which of the boards are turned over."""


@pytest.fixture
def best_of(monkeypatch):
    """The search over two boards whose solutions have these sums of squares."""

    def search(costs: dict[State, float]) -> State:
        def turned_over(_problem, state, turned):
            return tuple(now != (number in turned) for number, now in enumerate(state))

        monkeypatch.setattr(joint_search, "_excess", lambda _problem, _number: 0.0)
        monkeypatch.setattr(joint_search, "_poses", lambda _problem, _number: ("own", "other"))
        monkeypatch.setattr(joint_search, "_turned_over", turned_over)
        monkeypatch.setattr(joint_search, "_came_back", lambda _problem, one, two, number: one[number] == two[number])
        monkeypatch.setattr(joint_search, "lit", lambda _problem, state: state)
        monkeypatch.setattr(joint_search, "least_squares", lambda _problem, state: (state, costs[state]))
        surfaces = [SimpleNamespace(sweep=SimpleNamespace(name=name)) for name in ("first", "second")]
        problem = SimpleNamespace(boards=(0, 1), surfaces=surfaces)
        return joint_search.best_of_mirrored(problem, OWN, costs[OWN])

    return search


def test_two_solutions_that_are_nearly_equal_do_not_hinder_a_third_that_is_far_better(best_of):
    near = 1000.0 - TELL_APART / 2
    assert best_of({OWN: 1000.0, FIRST: near, SECOND: 10.0, BOTH: 10.0 + 2 * TELL_APART}) == SECOND


def test_a_solution_nearly_as_good_as_the_best_is_told_with_the_board_that_differs(best_of):
    with pytest.raises(CalibrationError, match="^first: two poses"):
        best_of({OWN: 1000.0, FIRST: 990.0, SECOND: 10.0, BOTH: 10.0 + TELL_APART / 2})


def test_boards_that_lie_right_are_left_as_they_are(best_of):
    assert best_of({OWN: 10.0, FIRST: 500.0, SECOND: 500.0, BOTH: 900.0}) == OWN
