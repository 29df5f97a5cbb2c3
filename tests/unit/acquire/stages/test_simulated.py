"""The simulated stage: order of events, credit, holds and stops."""

from __future__ import annotations

import queue
import time

import pytest

from acquire.contract.config.model import StageConfig
from acquire.contract.errors import CommandRefusedError
from acquire.stages.protocol import Held, Moved, Segment, SegmentDone, Stopped, Triggered
from acquire.stages.simulated import SimulatedStage
from tests.waiting import next_of


class Rig:
    def __init__(self, time_scale=1e-4):
        self.events = queue.Queue()
        self.line = []
        self.stage = SimulatedStage(
            StageConfig(), lambda at, _ns, way: self.line.append((at, way)), time_scale=time_scale
        )
        self.stage.open(self.events.put)

    def next(self):
        return next_of(self.events)

    def assert_silent(self, for_s):
        with pytest.raises(queue.Empty):
            self.events.get(timeout=for_s)


@pytest.fixture
def rig():
    found = Rig()
    yield found
    found.stage.close()


@pytest.fixture
def slow_rig():
    found = Rig(time_scale=1.0)
    yield found
    found.stage.close()


def test_a_segment_fires_at_each_place_and_says_so_in_order(rig):
    first_id = rig.stage.begin_segment(Segment(30, 3, 4, run_up_steps=10), 3)
    events = [rig.next() for _ in range(5)]
    assert [(event.trigger_id, event.shot_index, event.position_steps) for event in events[:4]] == [
        (first_id + j, j, 30 + 3 * j) for j in range(4)
    ]
    assert events[4] == SegmentDone(39)
    assert rig.line == [(30, 0), (33, 0), (36, 0), (39, 0)]


def test_triggers_are_counted_on_over_segments(rig):
    rig.stage.begin_segment(Segment(0, 3, 2), 1)
    for _ in range(3):
        rig.next()
    assert rig.stage.begin_segment(Segment(0, 3, 1), 0) == 2
    assert isinstance(rig.next(), Triggered) and isinstance(rig.next(), SegmentDone)


def test_no_credit_no_trigger(rig):
    rig.stage.begin_segment(Segment(0, 3, 4), 1)
    assert [rig.next().shot_index for _ in range(2)] == [0, 1]
    rig.assert_silent(0.1)
    rig.stage.grant(0)
    rig.assert_silent(0.05)
    rig.stage.grant(3)
    assert [rig.next().shot_index for _ in range(2)] == [2, 3]
    assert isinstance(rig.next(), SegmentDone)


def test_a_hold_is_told_once_and_a_resume_goes_on(rig):
    rig.stage.begin_segment(Segment(0, 3, 2), 0)
    assert isinstance(rig.next(), Triggered)
    rig.stage.hold()
    assert isinstance(rig.next(), Held)
    rig.stage.grant(1)
    rig.assert_silent(0.05)
    rig.stage.resume()
    assert rig.next().shot_index == 1
    assert isinstance(rig.next(), SegmentDone)


def test_a_move_goes_no_faster_than_it_is_told(slow_rig):
    start_s = time.monotonic()
    slow_rig.stage.move_to(40, 200.0)
    assert slow_rig.next().position_steps == 40
    assert time.monotonic() - start_s >= 0.2


def test_a_stop_ends_a_move_where_it_is(slow_rig):
    slow_rig.stage.move_to(4500)
    slow_rig.stage.stop()
    stopped = slow_rig.next()
    assert isinstance(stopped, Stopped) and stopped.position_steps < 4500 and stopped.position_trusted


def test_a_stop_ends_a_segment_that_waits_for_credit(rig):
    rig.stage.begin_segment(Segment(0, 3, 4), 0)
    assert isinstance(rig.next(), Triggered)
    rig.stage.stop()
    assert isinstance(rig.next(), Stopped)
    assert not rig.stage.status().moving


def test_a_stop_of_a_resting_stage_says_nothing_and_harms_nothing(rig):
    rig.stage.stop()
    rig.stage.move_to(10)
    assert rig.next() == Moved(10, True, rig.stage.status().zero_id)


def test_homing_makes_a_new_zero(rig):
    before = rig.stage.status().zero_id
    rig.stage.home()
    moved = rig.next()
    assert moved.position_steps == 0 and moved.zero_id not in ("", before)


def test_touching_the_limit_reports_no_lost_steps(rig):
    rig.stage.check_limit()
    assert rig.next().steps_lost == 0


def test_a_place_outside_the_travel_is_refused(rig):
    with pytest.raises(CommandRefusedError, match=r"0\.\.4500"):
        rig.stage.move_to(4501)
    with pytest.raises(CommandRefusedError, match="travel"):
        rig.stage.begin_segment(Segment(4490, 3, 10), 0)


def test_one_activity_at_a_time(slow_rig):
    slow_rig.stage.move_to(4500)
    with pytest.raises(CommandRefusedError, match="moving"):
        slow_rig.stage.move_to(0)
    slow_rig.stage.stop()
    slow_rig.next()


def test_a_sweep_on_the_fly_exposes_half_a_way_further_and_says_so(rig):
    rig.stage.begin_segment(Segment(30, 3, 3, "fly", dwell_ms=20.0, period_ms=60.0, run_up_steps=6), 2)
    events = [rig.next() for _ in range(3)]
    assert [event.position_steps for event in events] == [30, 33, 36]
    assert [event.position_um for event in events] == pytest.approx([3.175 * (place + 0.5) for place in (30, 33, 36)])
    assert rig.next() == SegmentDone(36)
    assert rig.line == pytest.approx([(30.5, 1.0), (33.5, 1.0), (36.5, 1.0)])


def test_a_sweep_on_the_fly_backward_exposes_on_the_other_side(rig):
    rig.stage.begin_segment(Segment(30, -3, 2, "fly", dwell_ms=20.0, period_ms=60.0), 1)
    assert rig.next().position_um == pytest.approx(3.175 * 29.5)


def test_no_credit_on_the_fly_is_told_as_a_hold_and_each_place_is_still_fired_once(rig):
    rig.stage.begin_segment(Segment(0, 3, 3, "fly", dwell_ms=20.0, period_ms=60.0, run_up_steps=6), 0)
    assert rig.next().shot_index == 0
    assert rig.next() == Held("no credit", 0)
    rig.stage.grant(2)
    assert [rig.next().shot_index for _ in range(2)] == [1, 2]
    assert rig.next() == SegmentDone(6)


def test_a_sweep_on_the_fly_faster_than_the_stage_is_refused(rig):
    with pytest.raises(CommandRefusedError, match="max_rate_hz"):
        rig.stage.begin_segment(Segment(0, 30, 3, "fly", period_ms=10.0), 2)
    assert not rig.stage.status().moving
