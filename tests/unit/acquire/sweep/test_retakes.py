"""Lost frames are not taken, so the next run includes them; a frame that is lost too often is named."""

from __future__ import annotations

from acquire.sweep.pairing import Shot
from acquire.sweep.retakes import Retakes


def shot(frame_index: int) -> Shot:
    return Shot(frame_index, 0, 0, 0, 0.0, 0, 0, 0)


def test_the_first_run_is_the_whole_plan_and_a_later_one_the_first_gap():
    retakes = Retakes(6, max_attempts=3)
    assert retakes.next_run() == (0, 5)
    retakes.taken |= {0, 1, 4}
    assert retakes.next_run() == (2, 3)
    retakes.taken |= {2, 3}
    assert retakes.next_run() == (5, 5)
    retakes.taken.add(5)
    assert retakes.next_run() is None


def test_each_loss_counts_as_an_attempt_until_a_frame_is_lost_too_often():
    retakes = Retakes(6, max_attempts=2)
    assert retakes.lose([shot(2), shot(3)]) is None
    hopeless = retakes.lose([shot(3)])
    assert hopeless is not None and hopeless.frame_index == 3
    assert retakes.attempts == {2: 1, 3: 2}
