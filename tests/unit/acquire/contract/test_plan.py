"""The plan: which frame is taken where."""

from __future__ import annotations

import numpy as np
import pytest

from acquire.contract.plan import SweepPlan


def plan(first, last, steps):
    return SweepPlan(first_steps=first, last_steps=last, steps_per_frame=steps, um_per_microstep=3.175)


@pytest.mark.parametrize(
    ("first", "last", "steps", "count", "end"),
    [(0, 1578, 3, 527, 1578), (0, 1579, 3, 527, 1578), (1578, 0, 3, 527, 0), (5, 5, 3, 1, 5), (10, 0, 4, 3, 2)],
)
def test_both_ends_are_included_and_the_way_back_works(first, last, steps, count, end):
    sweep = plan(first, last, steps)
    assert sweep.count == count
    assert sweep.position_steps(count - 1) == end


def test_positions_are_exact_multiples_of_the_microstep():
    assert np.array_equal(plan(0, 9, 3).positions_um(), np.array([0, 3, 6, 9]) * 3.175)
