"""A sweep: its phases, retakes, holds and ends, without any device."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from acquire.cameras.protocol import CameraFrame, CameraGone
from acquire.contract.messaging.messages import AckItem, EndAck, FrameFormat, Nack
from acquire.contract.states import HoldReason, Outcome, State
from acquire.stages.protocol import Alarm, Held, Stopped, Triggered
from acquire.sweep.actions import RaiseFault
from acquire.sweep.events import PauseRequested, Refused, ResumeRequested, StopRequested, Tick, WriterReady
from acquire.sweep.phases import Phase
from acquire.sweep.settings import OverlapLimits, ResumeFrom
from tests.unit.sweep_bench import MS, Bench, bench, done, settings


def test_an_undisturbed_sweep_takes_each_frame_once_at_its_place():
    on = bench(10)
    on.start()
    assert done(on) and on.sweep.outcome is Outcome.COMPLETE
    assert on.positions == [30 + 3 * k for k in range(10)] + [30]
    assert [image.frame_index for image in on.published if image.role == "sweep"] == list(range(10))
    assert on.end is not None and on.end.end.missing == [] and on.faults == []


def test_the_ambient_frame_is_taken_with_the_lamp_off_and_frame_0_repeated_at_the_end():
    on = bench(3)
    on.start()
    assert [image.role for image in on.published] == ["ambient", "sweep", "sweep", "sweep", "repeat"]
    assert on.lamp
    assert on.sweep.checks.measured["brightness_change"] == 0
    assert on.sweep.checks.measured["steps_lost"] == 0


def test_nothing_moves_before_the_writer_is_ready():
    on = bench()
    on.sweep.start(on.now_ns)
    on.tick(4999)
    assert on.triggers == [] and on.sweep.state is State.ARMED


def test_without_a_writer_the_sweep_is_refused_in_time_and_says_so():
    on = bench()
    on.sweep.start(on.now_ns)
    on.tick(5000)
    assert done(on) and on.sweep.outcome is Outcome.FAILED
    assert [fault.code for fault in on.faults] == ["F05"] and on.triggers == []


def test_a_stop_before_any_writer_came_does_not_wait_for_a_seal():
    sweep = bench(seal_ns=10**15).sweep
    sweep.start(0)
    sweep.handle(StopRequested(), 0)
    sweep.handle(Tick(), 0)
    assert sweep.phase is Phase.SEAL
    said = sweep.handle(Tick(), sweep.settings.writer_start_ns)
    assert sweep.phase is Phase.DONE and "F05" in [do.fault.code for do in said if isinstance(do, RaiseFault)]


def test_a_stop_is_sealed_by_a_writer_that_was_slow_to_come():
    sweep = bench(seal_ns=10**15).sweep
    sweep.start(0)
    for event in (StopRequested(), Tick(), WriterReady(reserved=True, came_back=False)):
        sweep.handle(event, 0)
    sweep.handle(Tick(), 10**14)
    assert sweep.phase is Phase.SEAL


def test_a_full_disk_is_found_before_anything_moves():
    on = bench()
    on.sweep.start(on.now_ns)
    on.feed(Refused(Nack(reason="no space", detail="needed 1 GB")))
    assert done(on) and [fault.code for fault in on.faults] == ["F06"] and on.triggers == []


@pytest.mark.parametrize("how", ["lose", "shape", "missed"])
def test_a_frame_that_did_not_come_right_is_taken_again_at_the_same_place(how):
    on = bench(10)
    on.spoil = lambda frame_index, attempt: how if (frame_index, attempt) == (4, 0) else ""
    on.start()
    on.tick(200)
    assert done(on) and on.sweep.outcome is Outcome.COMPLETE
    taken = [(image.frame_index, image.attempt) for image in on.published if image.role == "sweep"]
    assert taken == [(k, 1 if k == 4 else 0) for k in range(10)]
    assert on.positions.count(42) == 2
    assert on.end is not None and on.end.end.retaken == [(4, 4)]


def test_a_frame_that_is_lost_too_often_ends_the_sweep_as_failed_and_names_what_is_missing():
    on = bench(10)
    on.spoil = lambda frame_index, attempt: "missed" if frame_index == 4 else ""
    on.start()
    for _ in range(5):
        on.tick(200)
    assert done(on) and on.sweep.outcome is Outcome.FAILED
    assert on.end is not None and on.end.end.missing == [(4, 9)]
    assert [fault.code for fault in on.faults] == ["F16"]


def on_the_fly(count: int, tells_time: bool):
    plan = msgspec.structs.replace(settings(count).plan, mode="fly")
    # frames come in zero time one after the other: with a period, each but the first would be too early
    on = bench(count, plan=plan, period_ms=0)
    on.tells_time = tells_time
    return on


@pytest.mark.parametrize(("tells_time", "fired"), [(True, 10), (False, 5)])
def test_on_the_fly_several_frames_are_under_way_only_where_time_can_tell_them_apart(tells_time, fired):
    on = on_the_fly(10, tells_time)
    on.spoil = lambda frame_index, attempt: "missed" if (frame_index, attempt) == (4, 0) else ""
    on.start()
    assert len(on.triggers) == fired


def without_its_camera(**changes: object) -> Bench:
    """A sweep whose first four frames wait for the writer when the camera goes away, and are then committed."""
    on = bench(10, slots=4, **changes)
    on.acking = False
    on.start()
    on.feed(CameraGone("pulled"))
    on.acking = True
    on.ack_all()
    return on


def test_a_camera_that_went_away_is_waited_for_and_its_frames_are_taken_again():
    on = without_its_camera()
    on.tick(1)
    assert (on.sweep.state, on.sweep.hold_reason) == (State.HOLDING, HoldReason.CAMERA_AWAY)
    assert [fault.code for fault in on.faults] == ["F18"] and "pulled" in on.faults[0].happened
    assert len(on.triggers) == 4 and on.stops == 1, "no trigger for a camera that is not there"
    on.feed(CameraGone("", back=True))
    assert done(on) and on.sweep.outcome is Outcome.COMPLETE
    assert [image.frame_index for image in on.published if image.role == "sweep"] == list(range(10))


def test_a_camera_that_goes_away_after_the_last_frame_costs_the_sweep_nothing():
    on = bench(3)
    on.spoil = lambda frame_index, attempt: "gone" if frame_index == 2 else ""
    on.start()
    on.tick(1)
    assert done(on) and on.sweep.outcome is Outcome.COMPLETE


def test_a_camera_that_stays_away_leaves_the_sweep_interrupted_so_that_it_can_be_resumed():
    on = without_its_camera(camera_away_ns=500 * MS)
    on.tick(499)
    assert not done(on)
    on.tick(2)
    on.tick(1)
    assert done(on) and on.sweep.outcome is Outcome.INTERRUPTED
    assert on.end is not None and "F18" in on.end.end.reason and on.end.end.missing == [(4, 9)]


def test_a_sweep_that_is_stopped_while_its_camera_is_away_ends_at_once():
    on = without_its_camera()
    on.feed(StopRequested())
    on.tick(1)
    assert done(on) and on.sweep.outcome is Outcome.STOPPED


def test_a_camera_that_goes_away_while_the_lamp_warms_up_is_waited_for_before_the_first_trigger():
    on = bench(3)
    on.sweep.start(on.now_ns)
    on.feed(WriterReady(reserved=True, came_back=False))
    on.feed(CameraGone("pulled"))
    on.tick(1)
    assert on.triggers == [] and on.sweep.hold_reason is HoldReason.CAMERA_AWAY
    on.feed(CameraGone("", back=True))
    assert done(on) and on.sweep.outcome is Outcome.COMPLETE


def test_no_credit_no_trigger_and_the_sweep_resumes_when_half_the_window_is_free():
    on = bench(20, slots=4)
    on.acking = False
    on.start()
    assert [frame for frame, _ in on.triggers] == [0, 1, 2, 3]
    assert on.sweep.state is State.HOLDING and on.sweep.hold_reason is HoldReason.NO_CREDIT
    on.ack(2)
    assert len(on.triggers) == 4, "the ambient frame and one of four are committed"
    on.ack_all()
    assert [frame for frame, _ in on.triggers][4:8] == [4, 5, 6, 7]


def test_a_hold_for_want_of_credit_is_not_taken_for_a_dead_stage():
    on = bench(20, slots=4)
    on.acking = False
    on.start()
    on.tick(60_000)
    assert not done(on) and on.faults == []
    for _ in range(8):
        on.ack_all()
    assert done(on) and on.sweep.outcome is Outcome.COMPLETE


def test_a_paused_sweep_goes_on_where_it_was():
    on = bench(20, slots=4)
    on.acking = False
    on.start()
    on.feed(PauseRequested())
    assert on.sweep.hold_reason is HoldReason.PAUSED
    on.ack_all()
    on.tick(600_000)
    assert len(on.triggers) == 4
    on.acking = True
    on.feed(ResumeRequested())
    on.tick(1)
    assert done(on) and [frame for frame, _ in on.triggers] == [*range(20), 0]


def in_mid_run(**changes: object) -> Bench:
    """A sweep that has taken frame 0, whose stage is on its way to frame 1 and says nothing more."""
    on = bench(20, **changes)
    on.stage_is_dead = True
    on.start()
    on.feed(Triggered(1, 0, 30, at_mono_ns=on.now_ns))
    on.feed(CameraFrame(np.ones((4, 5), np.uint8), 99, on.now_ns))
    return on


def test_a_pause_may_last_longer_than_any_motion():
    on = in_mid_run()
    on.feed(PauseRequested())
    on.tick(60_000)
    assert (on.sweep.state, on.sweep.hold_reason, on.faults) == (State.HOLDING, HoldReason.PAUSED, [])
    on.feed(ResumeRequested())
    on.tick(5001)
    assert [fault.code for fault in on.faults] == ["F12"], "then the stage must answer again"


def test_a_stage_that_was_told_to_stop_must_answer_although_a_last_trigger_came():
    on = in_mid_run()
    on.feed(StopRequested())
    on.feed(Triggered(2, 1, 33, at_mono_ns=on.now_ns))
    for ms in (200, 5001, 1):
        on.tick(ms)
    assert done(on) and [fault.code for fault in on.faults] == ["F12"]


def test_the_end_is_sent_only_after_the_last_published_frame_is_committed():
    on = bench(2, check_limit=True, repeat_first=False, needs_confirmation=True)
    on.acking = False
    on.start()
    on.ack_all()
    assert on.sweep.phase is Phase.DRAIN and on.end is None, "frame 1 waits for its confirmation"
    on.feed(Tick(on.now_ns + 10 * MS))
    assert on.end is None, "its ack is on the way"
    on.ack_all()
    assert on.end is not None and on.end.end.missing == []


def test_a_stopped_sweep_keeps_what_was_taken_and_names_the_rest():
    on = bench(20, slots=4)
    on.acking = False
    on.start()
    on.feed(StopRequested())
    assert not done(on)
    on.ack_all()
    assert done(on) and on.sweep.outcome is Outcome.STOPPED
    assert on.end is not None and on.end.end.missing == [(4, 19)] and on.end.end.sent == 4


def test_a_stop_while_paused_ends_the_sweep():
    on = bench(20, slots=4)
    on.acking = False
    on.start()
    on.feed(PauseRequested())
    on.feed(StopRequested())
    on.ack_all()
    assert done(on) and on.sweep.outcome is Outcome.STOPPED


def _waits_for_its_writer(on):
    on.sweep.start(on.now_ns)


def _takes_the_ambient_frame(on):
    on.spoil = lambda frame_index, attempt: "missed" if frame_index < 0 else ""
    _waits_for_its_writer(on)
    on.feed(WriterReady(reserved=True, came_back=False))


def _warms_its_lamp(on):
    _waits_for_its_writer(on)
    on.feed(WriterReady(reserved=True, came_back=False))


def _has_no_credit(on):
    on.acking = False
    on.start()


def _is_paused(on):
    _has_no_credit(on)
    on.feed(PauseRequested())


def _waits_for_a_lost_frame(on):
    on.spoil = lambda frame_index, attempt: "missed" if frame_index == 4 else ""
    on.start()


@pytest.mark.parametrize(
    ("brought_to", "phase"),
    [
        (_waits_for_its_writer, "WAIT_WRITER"), (_takes_the_ambient_frame, "AMBIENT"), (_warms_its_lamp, "WARM_UP"),
        (_has_no_credit, "RUN"), (_is_paused, "RUN"), (_waits_for_a_lost_frame, "RUN"),
    ],
)  # fmt: skip
def test_told_to_end_in_any_phase_the_sweep_says_an_end_that_names_what_is_missing(brought_to, phase):
    on = bench(20, slots=4)
    brought_to(on)
    assert on.sweep.phase.name == phase
    on.feed(StopRequested(Outcome.ABORTED, "F24 told to end"))
    on.ack_all()
    for _ in range(4):
        on.tick(60)
    assert done(on) and on.sweep.outcome is Outcome.ABORTED
    taken = len([image for image in on.published if image.role == "sweep"])
    assert on.end is not None and on.end.end.missing == [(taken, 19)] and "F24" in on.end.end.reason
    assert not on.segment, "the stage runs on"


def test_an_alarm_of_the_stage_closes_the_sweep_as_aborted():
    on = bench(20, slots=4)
    on.acking = False
    on.start()
    on.feed(Alarm("F23", "limit switch", 33, position_trusted=False))
    on.ack_all()
    assert done(on) and on.sweep.outcome is Outcome.ABORTED and on.faults[0].code == "F23"


@pytest.mark.parametrize("code", ["F12", "F13", "F15"])
def test_a_controller_that_is_lost_leaves_the_sweep_interrupted_so_that_it_can_be_resumed(code):
    on = bench(10)
    on.spoil = lambda frame_index, attempt: "missed" if frame_index == 4 else ""
    on.start()
    on.feed(Alarm(code, "gone", 33, position_trusted=False))
    on.tick(200)
    on.tick(1)
    assert done(on) and on.sweep.outcome is Outcome.INTERRUPTED
    assert on.end is not None and on.end.end.outcome is Outcome.INTERRUPTED and code in on.end.end.reason
    assert on.end.end.missing == [(4, 9)]
    assert [fault.code for fault in on.faults] == [code]


@pytest.mark.parametrize(("reason", "code"), [("lease", "F15"), ("link lost", "F12")])
def test_a_controller_that_holds_by_itself_is_told_of_and_the_sweep_goes_on_with_it(reason, code):
    on = bench(10, slots=4)
    on.acking = False
    on.start()
    on.ack_all()
    on.feed(Held(reason, 40))
    assert [fault.code for fault in on.faults] == [code]
    assert (on.sweep.state, on.sweep.hold_reason) == (State.HOLDING, HoldReason.LINK_LOST)
    on.acking = True
    on.ack_all()
    assert done(on) and on.sweep.outcome is Outcome.COMPLETE


def test_a_frame_counts_only_when_the_controller_was_heard_after_its_exposure():
    on = bench(4, needs_confirmation=True)
    on.start()
    assert [image.role for image in on.published] == ["ambient"], "an exposure takes 10 ms"
    on.feed(Tick(on.now_ns + 9 * MS))
    assert len(on.published) == 1
    on.feed(Tick(on.now_ns + 10 * MS))
    on.tick(1)
    assert done(on) and on.sweep.outcome is Outcome.COMPLETE
    assert [image.frame_index for image in on.published[1:]] == [0, 1, 2, 3, 0]


@pytest.mark.parametrize(("code", "outcome"), [("F23", Outcome.ABORTED), ("F13", Outcome.INTERRUPTED)])
def test_a_frame_that_was_exposed_while_the_controller_stopped_by_itself_is_missing(code, outcome):
    on = bench(20, slots=4, needs_confirmation=True)
    on.start()
    on.feed(Tick(on.now_ns + 10 * MS))
    taken = len([image for image in on.published if image.role == "sweep"])
    on.feed(Alarm(code, "the lamp went out", 33, position_trusted=False))
    on.feed(Tick(on.now_ns + 10**12))
    on.tick(1)
    assert done(on) and on.sweep.outcome is outcome
    assert len([image for image in on.published if image.role == "sweep"]) == taken
    assert on.end is not None and on.end.end.missing == [(taken, 19)] and on.sweep.counters["doubtful"] > 0


def test_a_frame_that_the_file_will_never_take_ends_the_sweep_by_name_instead_of_blocking_it():
    on = bench(20, slots=4)
    on.acking = False
    on.start()
    on.unacked = [image for image in on.unacked if (image.role, image.frame_index) != ("sweep", 0)]
    on.feed(Refused(Nack(reason="immutable", frame_index=0, detail="frame 0 is committed with other pixels")))
    on.ack_all()
    assert done(on) and on.sweep.outcome is Outcome.FAILED and "other pixels" in on.faults[0].happened
    assert on.end is not None and on.end.end.missing[0][0] == 0


def test_a_check_frame_from_before_an_interruption_is_no_fault():
    on = bench(20, slots=4)
    on.acking = False
    on.start()
    on.feed(Refused(Nack(reason="immutable", frame_index=0, role="repeat")))
    assert on.faults == [] and on.sweep.outcome is Outcome.RUNNING


def test_a_trigger_at_another_place_than_planned_is_never_taken_for_right():
    on = bench(20, slots=4)
    on.acking = False
    on.start()
    on.feed(Triggered(99, 4, 999))
    on.ack_all()
    assert done(on) and on.sweep.outcome is Outcome.FAILED
    assert on.end is not None and on.end.end.missing == [(4, 19)]


def test_a_stage_that_falls_silent_is_a_fault_and_not_an_endless_wait():
    on = bench(20)
    on.sweep.start(on.now_ns)
    on.stage_is_dead = True
    on.feed(WriterReady(reserved=True, came_back=False))
    on.tick(1)
    on.tick(5001)
    assert on.faults[0].code == "F12" and on.sweep.outcome is Outcome.INTERRUPTED
    assert on.stops == 1, "it may still hear"


def test_a_writer_that_never_seals_leaves_the_scan_interrupted_not_complete():
    on = bench(3)
    on.acking = False
    on.start()
    on.tick(5001)
    assert done(on) and on.sweep.outcome is Outcome.INTERRUPTED
    assert on.faults[-1].code == "F03"


def test_a_late_report_of_the_stage_does_not_end_the_wait_for_the_writer():
    on = bench()
    on.sweep.start(on.now_ns)
    on.feed(Stopped(33, position_trusted=True))
    on.tick(5000)
    assert done(on) and [fault.code for fault in on.faults] == ["F05"]


def test_a_late_report_of_the_stage_does_not_end_the_wait_for_the_seal():
    on = bench(3)
    on.acking = False
    on.start()
    assert on.sweep.phase is Phase.DRAIN
    on.feed(Stopped(33, position_trusted=True))
    on.tick(5001)
    assert done(on) and on.sweep.outcome is Outcome.INTERRUPTED and on.faults[-1].code == "F03"


def test_frames_that_the_writer_finds_damaged_when_it_seals_are_not_called_safe():
    on = bench(5)
    on.sealed = EndAck(path="x", sealed=False, outcome=Outcome.RUNNING, committed=3, missing=[(1, 2)], reason="damaged")
    on.start()
    assert done(on) and on.sweep.outcome is Outcome.INTERRUPTED
    assert sorted(on.sweep.window.committed) == [0, 3, 4] and on.sweep.window.prefix == 1
    assert "3 of 5 frames" in on.faults[-1].safe and "resume" in on.faults[-1].to_do


def resumed(count=10, last=3, moved=False):
    """A sweep whose frames 0..last are committed already; ``moved``: the rig shows something else than it did."""
    scene = np.kron(np.random.default_rng(1).integers(0, 200, (8, 8)), np.ones((8, 8))).astype(np.uint8)
    shown = np.roll(scene, 4, axis=1) if moved else scene
    past = ResumeFrom(last, scene, None, scene, OverlapLimits())
    on = bench(count, resume=past, format=FrameFormat(width=64, height=64, bit_depth=8))
    on.picture = shown
    on.committed = tuple(AckItem(k, 0, k) for k in range(last + 1))
    return on


def test_a_resumed_sweep_takes_its_last_frame_again_and_then_only_what_is_missing():
    on = resumed()
    on.start()
    assert done(on) and on.sweep.outcome is Outcome.COMPLETE
    assert [image.role for image in on.published] == ["overlap", *["sweep"] * 6, "repeat"]
    assert [image.frame_index for image in on.published] == [3, *range(4, 10), 0]
    assert on.sweep.checks.measured["overlap_specimen_px"] == pytest.approx(0, abs=1e-6)


def test_a_resumed_sweep_does_not_go_on_where_something_moved():
    on = resumed(moved=True)
    on.start()
    on.tick(1)
    on.tick(1)
    assert done(on) and on.sweep.outcome is Outcome.INTERRUPTED
    assert on.end is not None and "overlap" in on.end.end.reason
    assert [image.role for image in on.published] == ["overlap"]
    assert "moved" in on.faults[0].happened and "4 of 10" in on.faults[0].safe


def test_a_resumed_sweep_whose_overlap_frame_does_not_come_stays_interrupted():
    on = resumed()
    on.spoil = lambda frame_index, attempt: "missed" if attempt == 0 else ""
    on.start()
    on.tick(200)
    on.tick(1)
    on.tick(1)
    on.tick(1)
    assert done(on) and on.sweep.outcome is Outcome.INTERRUPTED
