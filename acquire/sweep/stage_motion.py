"""What the stage does next: runs until each frame is taken, then the checks. Nothing begins while it moves."""

from __future__ import annotations

import msgspec

from acquire.contract.states import Outcome

from .actions import Action, Arm, BeginSegment, CheckLimit, Disarm, RaiseFault, Say
from .finish import drain, end_early
from .phases import Decision, Phase
from .sweep_state import SweepState


def first_motion(sweep: SweepState, now_ns: int) -> list[Action]:
    """Begin the first run; a resumed sweep takes its last frame again first, to compare it."""
    resume = sweep.settings.resume
    if resume is None:
        return _begin_run(sweep, 0, sweep.count - 1, now_ns)
    return _begin(sweep, Decision.COMPARE_OVERLAP, resume.last_frame, resume.last_frame, now_ns)


def next_motion(sweep: SweepState, now_ns: int) -> list[Action]:
    """The stage rests and no frame is awaited: take missing frames, then make the checks, then end."""
    if sweep.phase is Phase.OVERLAP:
        if sweep.checks.complaint:
            return _refuse_overlap(sweep, now_ns)
        return [Say("the rig has not moved: the sweep goes on"), *_next_run(sweep, now_ns)]
    if sweep.phase is Phase.REPEAT:
        return _check_limit(sweep, now_ns)
    if sweep.is_decided:
        drain(sweep, now_ns)
        return [Disarm()]
    return [] if sweep.paused else _next_run(sweep, now_ns)


def _next_run(sweep: SweepState, now_ns: int) -> list[Action]:
    """Take the first missing frames, retakes included; when all are taken, take frame 0 again for the drift check."""
    run = sweep.retakes.next_run()
    if run is not None:
        return _begin_run(sweep, *run, now_ns)
    can_compare = sweep.checks.first is not None and not sweep.away
    if sweep.skip_checks or not sweep.settings.repeat_first or not can_compare:
        return _check_limit(sweep, now_ns)
    return _begin(sweep, Decision.REPEAT_FIRST, 0, 0, now_ns)


def _begin_run(sweep: SweepState, first: int, last: int, now_ns: int) -> list[Action]:
    if not sweep.away:
        return _begin(sweep, Decision.BEGIN_RUN, first, last, now_ns)
    return [] if sweep.phase is Phase.STOPPING else sweep.stop_stage(Decision.AWAIT_CAMERA, now_ns)


def _begin(sweep: SweepState, decision: Decision, first: int, last: int, now_ns: int) -> list[Action]:
    """Arm the camera and start a segment over the frames first..last; a check frame needs no credit."""
    sweep.move(decision, now_ns)
    sweep.intake.arm(now_ns)
    gated = decision is Decision.BEGIN_RUN
    credit = sweep.window.begin(first, last, gated=gated, ahead=sweep.intake.ahead)
    return [Arm(), BeginSegment(sweep.settings.segment(first, last), credit)]


def _check_limit(sweep: SweepState, now_ns: int) -> list[Action]:
    if sweep.skip_checks or not sweep.settings.check_limit:
        drain(sweep, now_ns)
        return [Disarm()]
    sweep.move(Decision.CHECK_LIMIT, now_ns)
    return [Disarm(), CheckLimit()]


def _refuse_overlap(sweep: SweepState, now_ns: int) -> list[Action]:
    complaint = sweep.checks.complaint
    fault = msgspec.structs.replace(
        sweep.fault("F01"),
        happened=f"the scan cannot go on: {complaint} (overlap.png beside the scan shows it)",
        to_do="put it back, or home the stage, and resume; or close the scan: 'sweepscope recover --seal'",
    )
    return [RaiseFault(fault), *end_early(sweep, Outcome.INTERRUPTED, f"overlap check: {complaint}", now_ns)]
