"""The state machine of one sweep: events in, actions out. Pure: no device, socket or clock, and nothing is shared.

It guarantees that every frame is either committed or named as missing, that the stage ends stopped, and that nothing
ends as complete that is not. This file handles the events; what the stage does next is decided in
:mod:`acquire.sweep.stage_motion`, how the sweep ends in :mod:`acquire.sweep.finish`. The phase changes only by the
table in :mod:`acquire.sweep.phases`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from acquire.cameras.protocol import CameraFrame, CameraGone
from acquire.contract.process.log_throttle import is_power_of_ten
from acquire.contract.states import Outcome
from acquire.stages.protocol import Alarm, Held, Moved, SegmentDone, Stopped, Triggered

from . import events as on
from .actions import Action, Grant, HoldStage, RaiseFault, ResumeStage, SaveMarks, Say, StopStage
from .finish import drain, end_early, give_up, seal_if_settled, sealed, writer_is_late
from .frame_intake import Loss
from .phases import CHECK_PHASES, STAGE_PHASES, Decision, Phase
from .stage_motion import first_motion, next_motion
from .sweep_state import SweepState
from .writer_events import refused, writer_ready

_CAN_BE_RESUMED = frozenset({"F12", "F13", "F15"})
"""Alarms after which the specimen and the frames are as they were: the scan stays partial."""
_LOST_CONTACT = {"lease": "F15", "link lost": "F12"}
"""Reasons for which the controller holds by itself, and their faults."""


class Sweep(SweepState):
    """One sweep from its start to its sealed end."""

    def start(self, now_ns: int) -> None:
        """The writer was told to create the file; nothing moves until it has."""
        self.deadline_ns = now_ns + self.settings.writer_start_ns

    def handle(self, event: on.SweepEvent, now_ns: int) -> list[Action]:
        """Take one event; returns the actions that it causes, in order.

        Raises:
            IllegalTransitionError: a bug: the table of phases has no such transition.
        """
        if self.phase is Phase.DONE:
            return []
        actions = HANDLERS[type(event)](self, event, now_ns)
        if self.phase is Phase.DRAIN:
            return actions + seal_if_settled(self, now_ns)
        if self.phase in STAGE_PHASES and self.at_rest and not self.intake.pairing.pending:
            return actions + next_motion(self, now_ns)
        return actions


# ---- triggers and frames ----


def _on_triggered(sweep: Sweep, event: Triggered, now_ns: int) -> list[Action]:
    sweep.position_steps, sweep.lost_contact = event.position_steps, False
    sweep.intake.counters["check_triggers" if sweep.phase in CHECK_PHASES else "triggered"] += 1
    frame_index = sweep.window.first + event.shot_index
    planned = sweep.settings.plan.position_steps(frame_index)
    if event.position_steps != planned or not sweep.window.trigger(frame_index):
        wrong = f"frame {frame_index} was triggered at {event.position_steps} microsteps, planned {planned}"
        return give_up(sweep, Outcome.FAILED, "F15", wrong, now_ns)
    sweep.intake.triggered(event, frame_index, sweep.retakes.attempts.get(frame_index, 0), now_ns)
    _expect_stage(sweep, now_ns)
    early = sweep.intake.early(now_ns)
    return [action for frame in early for action in _take_frame(sweep, frame, now_ns, was_early=True)]


def _on_frame(sweep: Sweep, event: CameraFrame, now_ns: int) -> list[Action]:
    sweep.intake.counters["check_frames" if sweep.phase in CHECK_PHASES else "received"] += 1
    if sweep.phase is Phase.AMBIENT:
        return [*sweep.intake.take_ambient(event, sweep.position_steps), *sweep.light_lamp(now_ns)]
    if sweep.window.running and sweep.intake.keep_early(event, now_ns):
        return []
    return _take_frame(sweep, event, now_ns)


def _take_frame(sweep: Sweep, frame: CameraFrame, now_ns: int, *, was_early: bool = False) -> list[Action]:
    arrival = sweep.intake.pair(frame, was_early=was_early)
    actions = [action for loss in arrival.losses for action in _retake(sweep, loss, now_ns)]
    if arrival.extra and is_power_of_ten(sweep.intake.counters["extra"]):
        actions.append(RaiseFault(sweep.fault("F17", count=sweep.intake.counters["extra"])))
    if arrival.shot is None:
        return actions
    if sweep.phase is Phase.REPEAT:
        sweep.checks.compare_first(frame.pixels)
        return [*actions, *sweep.intake.take(frame, arrival.shot, "repeat")]
    if sweep.phase is Phase.OVERLAP:
        picture = sweep.checks.compare_overlap(frame.pixels)
        return [*actions, *sweep.intake.take(frame, arrival.shot, "overlap"), picture]
    sweep.retakes.taken.add(arrival.shot.frame_index)
    actions += sweep.intake.take(frame, arrival.shot, "sweep")
    return actions + _watch_light(sweep, frame, arrival.shot.frame_index, now_ns) + _grant(sweep, now_ns)


def _watch_light(sweep: Sweep, frame: CameraFrame, frame_index: int, now_ns: int) -> list[Action]:
    """In another light S is wrong for every pixel: hold, and let the operator decide."""
    if frame_index == 0:
        sweep.checks.first = frame.pixels
    found = None if sweep.paused else sweep.checks.light.update(frame_index, frame.pixels)
    if found is None:
        return []
    since, change = found
    fault = RaiseFault(sweep.fault("F27", detail=f"{change} since frame {since}"))
    return [fault, SaveMarks(sweep.checks.note_light_change(since)), *_hold(sweep, now_ns)]


def _retake(sweep: Sweep, loss: Loss, now_ns: int) -> list[Action]:
    """Stop the run, so that the next one takes the lost frames again. A frame that is lost too often is a fault."""
    if sweep.phase in (Phase.REPEAT, Phase.OVERLAP) or not loss.shots:
        return []
    hopeless = sweep.retakes.lose(loss.shots)
    if hopeless is not None:
        frame, attempts = hopeless.frame_index, sweep.retakes.attempts[hopeless.frame_index]
        fault = sweep.fault(loss.code, frame=frame, attempts=attempts, detail=loss.detail)
        return [RaiseFault(fault), *end_early(sweep, Outcome.FAILED, f"{loss.code} {fault.happened}", now_ns)]
    if sweep.phase is not Phase.RUN:
        return []
    told = Say(f"frame {loss.shots[0].frame_index} is taken again: {loss.detail}")
    return [told, *sweep.stop_stage(Decision.RETAKE, now_ns)]


def _on_camera_gone(sweep: Sweep, event: CameraGone, now_ns: int) -> list[Action]:
    was_away, gone_ns = sweep.away, sweep.camera_gone_ns
    if event.back:
        sweep.camera_gone_ns = None
        return [Say("the camera is back: lost frames are taken again")] if was_away else []
    actions: list[Action] = [] if was_away else [RaiseFault(sweep.fault("F18", detail=event.detail))]
    actions += _retake(sweep, sweep.intake.camera_gone(event.detail), now_ns)
    sweep.camera_gone_ns = now_ns if gone_ns is None else gone_ns
    return actions + (sweep.stop_stage(Decision.AWAIT_CAMERA, now_ns) if sweep.phase is Phase.RUN else [])


def _grant(sweep: Sweep, now_ns: int) -> list[Action]:
    """Raise the stage's credit as far as the window allows."""
    if sweep.phase is not Phase.RUN or sweep.paused:
        return []
    credit = sweep.window.grant(sweep.intake.ahead)
    _expect_stage(sweep, now_ns)
    return [] if credit is None else [Grant(credit)]


# ---- the stage ----


def _on_rest(sweep: Sweep, event: SegmentDone | Moved | Stopped, now_ns: int) -> list[Action]:
    sweep.position_steps, sweep.lost_contact = event.position_steps, False
    sweep.rest()
    if sweep.phase is Phase.LIMIT:
        if isinstance(event, Moved) and event.steps_lost is not None:
            sweep.checks.measured["steps_lost"] = float(event.steps_lost)
        drain(sweep, now_ns)
    elif sweep.phase in STAGE_PHASES:
        sweep.deadline_ns = None
    return []


def _on_held(sweep: Sweep, event: Held, now_ns: int) -> list[Action]:
    sweep.position_steps = event.position_steps
    if event.reason not in _LOST_CONTACT:
        return []
    sweep.lost_contact = True
    return [RaiseFault(sweep.fault(_LOST_CONTACT[event.reason], detail="waiting for it"))]


def _on_alarm(sweep: Sweep, event: Alarm, now_ns: int) -> list[Action]:
    sweep.position_steps, sweep.lost_contact = event.position_steps, False
    sweep.distrust_stage()
    outcome = Outcome.INTERRUPTED if event.code in _CAN_BE_RESUMED else Outcome.ABORTED
    return give_up(sweep, outcome, event.code, event.detail, now_ns)


def _expect_stage(sweep: Sweep, now_ns: int) -> None:
    """The stage must answer by the deadline, but not while it holds or has no credit."""
    if sweep.phase in STAGE_PHASES:
        in_run = sweep.phase is Phase.RUN
        awaited = sweep.window.awaits_trigger() and not sweep.paused if in_run else not sweep.at_rest
        sweep.deadline_ns = now_ns + sweep.settings.motion_ns if awaited else None


# ---- the operator ----


def _on_pause(sweep: Sweep, event: on.PauseRequested, now_ns: int) -> list[Action]:
    return _hold(sweep, now_ns) if sweep.can_pause and not sweep.paused else []


def _hold(sweep: Sweep, now_ns: int) -> list[Action]:
    sweep.paused = True
    if sweep.phase is not Phase.RUN:
        return []
    _expect_stage(sweep, now_ns)
    return [HoldStage()]


def _on_resume(sweep: Sweep, event: on.ResumeRequested, now_ns: int) -> list[Action]:
    if not sweep.paused:
        return []
    sweep.paused = False
    sweep.checks.accept_light()
    return [ResumeStage(), *_grant(sweep, now_ns)] if sweep.phase is Phase.RUN else []


def _on_stop(sweep: Sweep, event: on.StopRequested, now_ns: int) -> list[Action]:
    return end_early(sweep, event.outcome, event.reason, now_ns)


# ---- the writer ----


def _on_committed(sweep: Sweep, event: on.Committed, now_ns: int) -> list[Action]:
    sweep.window.commit(event.frames)
    sweep.durable_count = event.durable_count
    return _grant(sweep, now_ns)


# ---- time ----


def _on_tick(sweep: Sweep, event: on.Tick, now_ns: int) -> list[Action]:
    actions: list[Action] = [*sweep.intake.confirm(event.no_alarm_ns)]
    if sweep.camera_is_missed(now_ns):
        actions += give_up(sweep, Outcome.INTERRUPTED, "F18", "it did not return", now_ns)
    loss = sweep.intake.overdue(now_ns)
    if loss is not None:
        return actions + _retake(sweep, loss, now_ns)
    if sweep.deadline_ns is None or now_ns < sweep.deadline_ns:
        return actions
    sweep.deadline_ns = None
    return actions + _time_is_up(sweep, now_ns)


def _time_is_up(sweep: Sweep, now_ns: int) -> list[Action]:
    if sweep.phase in (Phase.WAIT_WRITER, Phase.DRAIN, Phase.SEAL):
        return writer_is_late(sweep, now_ns)
    if sweep.phase is Phase.AMBIENT:
        return [Say("no ambient frame arrived: the camera does not answer"), *sweep.light_lamp(now_ns)]
    if sweep.phase is Phase.WARM_UP:
        return first_motion(sweep, now_ns)
    sweep.distrust_stage()
    # a stage that does not answer may still obey
    return [StopStage(), *give_up(sweep, Outcome.INTERRUPTED, "F12", "the stage does not answer", now_ns)]


HANDLERS: dict[type, Callable[[Sweep, Any, int], list[Action]]] = {
    on.WriterReady: writer_ready,
    on.Committed: _on_committed,
    on.Refused: refused,
    on.Sealed: sealed,
    Triggered: _on_triggered,
    SegmentDone: _on_rest,
    Moved: _on_rest,
    Stopped: _on_rest,
    Held: _on_held,
    Alarm: _on_alarm,
    CameraFrame: _on_frame,
    CameraGone: _on_camera_gone,
    on.PauseRequested: _on_pause,
    on.ResumeRequested: _on_resume,
    on.StopRequested: _on_stop,
    on.Tick: _on_tick,
}
