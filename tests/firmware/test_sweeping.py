"""Segments: every trigger at its microstep, none without credit, none lost or doubled by holds."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from acquire.contract.errors import CommandRefusedError
from acquire.stages.protocol import Held, Moved, Segment, SegmentDone, Stopped, Triggered

STEP = Segment(30, 3, 12, mode="step", settle_ms=0.5, dwell_ms=1.0, run_up_steps=20)
FLY = Segment(30, 3, 40, mode="fly", period_ms=1000 / 60, run_up_steps=20)


def true_positions(bench, first=0):
    return [edge.position_steps - bench.offset for edge in bench.edges[first:]]


def wanted(segment):
    return [segment.first_steps + j * segment.pitch_steps for j in range(segment.count)]


@pytest.mark.parametrize("segment", [STEP, FLY], ids=["step", "fly"])
def test_every_shot_is_fired_at_its_microstep(bench, segment):
    shots = bench.sweep(segment)
    assert [shot.position_steps for shot in shots] == wanted(segment)
    assert [shot.shot_index for shot in shots] == list(range(segment.count))
    assert true_positions(bench) == wanted(segment)
    bench.assert_true_position()


@pytest.mark.parametrize("mode", ["step", "fly"])
def test_a_sweep_can_run_backwards(bench, mode):
    segment = Segment(600, -3, 10, mode=mode, period_ms=10, run_up_steps=20)
    bench.sweep(segment)
    assert true_positions(bench) == wanted(segment)


def test_steps_never_go_back_within_a_step_mode_sweep(bench):
    bench.move(10)
    before = bench.pins().steps
    bench.sweep(STEP)
    way = STEP.run_up_steps + 3 * (STEP.count - 1)
    assert bench.pins().steps - before == abs(30 - 20 - 10) + way


def test_fly_mode_triggers_are_evenly_spaced_to_the_microsecond(bench):
    bench.sweep(FLY)
    cycles = [edge.cycles for edge in bench.edges]
    gaps = [later - earlier for earlier, later in zip(cycles, cycles[1:], strict=False)]
    assert max(gaps) - min(gaps) <= 4 * 16
    assert abs(sum(gaps) / len(gaps) - 16_000_000 / 60) < 16


def test_the_position_of_a_frame_taken_on_the_fly_is_the_one_at_mid_exposure(bench):
    (shot, *_) = bench.sweep(Segment(30, 4, 5, mode="fly", period_ms=20, dwell_ms=10, run_up_steps=20))
    assert shot.position_um == pytest.approx((30 + 4 * 5 / 20) * bench.config.um_per_microstep)
    (shot, *_) = bench.sweep(STEP)
    assert shot.position_um is None


def test_no_shot_is_fired_without_credit_and_the_grant_is_absolute(bench):
    bench.stage.begin_segment(STEP, 3)
    bench.wait_until(lambda event: isinstance(event, Triggered) and event.shot_index == 3)
    bench.stage.grant(1)
    bench.until(lambda: bench.stage.report.hold_reason == 3)  # no credit
    assert bench.pins().triggers == 4
    bench.stage.grant(STEP.count - 1)
    bench.stage.grant(STEP.count - 1)
    bench.wait(SegmentDone)
    assert true_positions(bench) == wanted(STEP)


def test_fly_mode_without_credit_backs_up_and_fires_at_the_right_microstep(bench):
    bench.stage.begin_segment(FLY, 9)
    held = bench.wait(Held)
    assert held.reason == "no credit"
    bench.stage.grant(19)
    bench.wait(Held)
    bench.stage.grant(39)
    bench.wait(SegmentDone)
    assert true_positions(bench) == wanted(FLY)
    bench.assert_true_position()


@pytest.mark.parametrize("segment", [STEP, FLY], ids=["step", "fly"])
def test_a_hold_and_a_resume_lose_and_double_nothing(bench, segment):
    segment = replace(segment, count=120)  # on a busy machine the holds come late, but before its end
    bench.stage.begin_segment(segment, segment.count - 1)
    for at in (2, 5, 6):
        bench.wait_until(lambda event, at=at: isinstance(event, Triggered) and event.shot_index >= at)
        bench.stage.hold()
        bench.wait_until(lambda event: isinstance(event, Held) and event.reason == "requested")
        fired = bench.pins().triggers
        bench.stage.resume()
        bench.until(lambda fired=fired: bench.pins().triggers > fired)
    bench.wait(SegmentDone)
    assert true_positions(bench) == wanted(segment)


def test_a_stop_ends_a_segment_and_the_next_one_starts_clean(bench):
    bench.stage.begin_segment(FLY, FLY.count - 1)
    bench.wait_until(lambda event: isinstance(event, Triggered) and event.shot_index == 5)
    bench.stage.stop()
    stopped = bench.wait(Stopped)
    assert stopped.position_trusted
    fired = len(bench.edges)
    shots = bench.sweep(STEP)
    assert [shot.trigger_id for shot in shots] == list(range(fired, fired + STEP.count))
    assert true_positions(bench, fired) == wanted(STEP)


def test_one_lost_frame_is_taken_again_at_its_place(bench):
    bench.sweep(STEP)
    (again,) = bench.sweep(Segment(45, 3, 1, run_up_steps=20, settle_ms=0.5))
    assert again.position_steps == 45 and again.trigger_id == STEP.count
    assert true_positions(bench)[-1] == 45


def test_the_period_is_kept_between_triggers_in_step_mode(bench):
    bench.sweep(Segment(30, 3, 5, period_ms=40, run_up_steps=20))
    cycles = [edge.cycles for edge in bench.edges]
    assert all(later - earlier >= 40 * 16_000 for earlier, later in zip(cycles, cycles[1:], strict=False))


def test_strobes_are_counted(bench):
    bench.sweep(STEP)
    bench.until(lambda: bench.stage.counters()["strobes"] == STEP.count)


def test_a_segment_needs_a_trusted_position(make_bench):
    bench = make_bench(homed=False)
    with pytest.raises(CommandRefusedError, match="home"):
        bench.stage.begin_segment(STEP, 0)
    assert bench.pins().steps == 0


def test_a_segment_that_leaves_the_travel_or_is_too_fast_is_refused(bench):
    before = bench.pins().steps
    with pytest.raises(CommandRefusedError, match="travel"):
        bench.stage.begin_segment(Segment(4490, 3, 10), 0)
    with pytest.raises(CommandRefusedError, match="faster"):
        bench.stage.begin_segment(Segment(30, 3, 10, mode="fly", period_ms=1), 0)
    assert bench.pins().steps == before
    assert bench.move(0) == Moved(0, True, bench.stage.status().zero_id)
