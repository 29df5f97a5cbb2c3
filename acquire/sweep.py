"""The sweep as a pure state machine: events in, actions out.

It promises that every frame index is either committed or named as missing, that the stage ends stopped, and that
nothing ends as complete that is not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Any

import msgspec
from numpy.typing import NDArray

from acquire.cameras.protocol import CameraFrame, CameraGone
from acquire.contract.faults import report
from acquire.contract.messages import FaultReport, Role
from acquire.contract.states import HoldReason, Outcome, State
from acquire.contract.units import NS_PER_S
from acquire.stages.protocol import Alarm, Held, Moved, SegmentDone, Stopped, Triggered

from .actions import (
    Action,
    Attach,
    CheckLimit,
    Disarm,
    Finish,
    HoldStage,
    Mark,
    Publish,
    RaiseFault,
    ResumeStage,
    Say,
    SetLamp,
    Snap,
    StopStage,
)
from .complaints import is_worth_saying
from .documents import end_of_sweep, image_of_shot, image_of_snap, what_is_wrong
from .drift import measure_drift
from .events import (
    Committed,
    PauseRequested,
    Refused,
    ResumeRequested,
    Sealed,
    StopRequested,
    SweepEvent,
    Tick,
    WriterReady,
)
from .lamp_watch import LampWatch
from .lockstep import Shot
from .overlap import compare_overlap, overlap_picture
from .shooting import Shooting
from .unproven import Unproven


class Phase(Enum):
    """Where in its course a sweep is."""

    WAIT_WRITER = auto()
    AMBIENT = auto()
    WARM_UP = auto()
    OVERLAP = auto()
    """The last frame before an interruption is taken again and compared."""
    RUN = auto()
    STOPPING = auto()
    """The segment was told to stop; what follows is decided when the stage rests."""
    REPEAT = auto()
    LIMIT = auto()
    DRAIN = auto()
    """Frames that were taken are being committed."""
    SEAL = auto()
    DONE = auto()


COUNTERS: tuple[str, ...] = (
    "triggered",
    "received",
    "extra",
    "damaged",
    "lost",
    "doubtful",
    "check_triggers",
    "check_frames",
)
_CAN_BE_RESUMED = frozenset({"F12", "F13", "F15"})
"""Alarms after which the specimen and the frames are as they were: the scan stays partial."""
_SILENCES = {"lease": "F15", "link lost": "F12"}
"""Holds of the controller's own making, and the faults that they are."""
_DAMAGED = ("crc", "shape")
"""Refusals of a frame that was not what was sent; it is sent again."""
_NO_FAULT = ("no such scan", "busy", "superseded")
"""What a writer says while it comes and goes."""
_FOR_GOOD = ("immutable", "protocol")
"""Refusals of a frame that sending it again would not change."""
_CHECKS = (Phase.AMBIENT, Phase.OVERLAP, Phase.REPEAT)
_SHOOTING = (Phase.OVERLAP, Phase.RUN, Phase.STOPPING, Phase.REPEAT)
_BEFORE = (Phase.WAIT_WRITER, Phase.AMBIENT, Phase.WARM_UP)


@dataclass
class Sweep:
    """One sweep from its start to its sealed end."""

    shooting: Shooting
    phase: Phase = Phase.WAIT_WRITER
    outcome: Outcome = Outcome.RUNNING
    reason: str = ""
    counters: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTERS, 0))
    checks: dict[str, float] = field(default_factory=dict)
    paused: bool = False
    silent: bool = False
    """The controller holds because it did not hear the host, or is gone; it goes on by itself when it does."""
    durable: int = 0
    result: Sealed | None = None
    position_steps: int = 0
    """Where the stage was last heard of, in microsteps."""
    _resting: bool = True
    _just_proven: bool = False
    """Frames were sent on their way by this very tick: the window does not know them yet."""
    _deaf: bool = False
    """The controller has failed: no frame that comes now can be trusted."""
    _skip_checks: bool = False
    _has_writer: bool = False
    """A writer was ready at least once."""
    _deadline_ns: int | None = None
    _first_pixels: NDArray[Any] | None = None
    _light_is_judged: bool = False
    """It is paused because the light changed: to resume is to accept the light."""
    _complaint: str = "the frame did not come again"
    """Why a resumed sweep must not go on; empty once the overlap check has passed."""

    def __post_init__(self) -> None:
        self.settings = self.shooting.settings
        self.window = self.shooting.window
        self.count = self.settings.plan.count
        if self.settings.resume is not None:
            self.checks |= self.settings.resume.marks
        self._unproven = Unproven(self.settings.needs_proof)
        self._light = LampWatch((1 << self.settings.format.bit_depth) - 1)

    # ---- the door ----

    def start(self, now_ns: int) -> None:
        """The writer was told to make the file; nothing moves until it has."""
        self._deadline_ns = now_ns + self.settings.writer_start_ns

    def handle(self, event: SweepEvent, now_ns: int) -> list[Action]:
        """Take one event and say what is to be done about it, in order."""
        if self.phase is Phase.DONE:
            return []
        handler = _HANDLERS[type(event)]
        return handler(self, event, now_ns) + self._look_around(now_ns)

    @property
    def state(self) -> State:
        """The rig's state that belongs to the phase."""
        if self.phase in _BEFORE:
            return State.ARMED
        if self.phase in _SHOOTING:
            holding = self.paused or self.silent or self.shooting.short_of_credit
            return State.HOLDING if holding else State.SWEEPING
        return State.FINISHING

    @property
    def hold_reason(self) -> HoldReason | None:
        """Why it holds; None when it does not."""
        if self.state is not State.HOLDING:
            return None
        if self.paused:
            return HoldReason.PAUSED
        return HoldReason.LINK_LOST if self.silent else HoldReason.NO_CREDIT

    @property
    def can_pause(self) -> bool:
        """True while frames are being taken."""
        return self.phase in (Phase.RUN, Phase.STOPPING) and self.outcome is Outcome.RUNNING

    # ---- before the first frame ----

    def _on_writer_ready(self, event: WriterReady, now_ns: int) -> list[Action]:
        if not self._has_writer and self.phase is Phase.SEAL:
            self._deadline_ns = now_ns + self.settings.seal_ns
        self._has_writer = True
        if self.phase is not Phase.WAIT_WRITER:
            return [Say("the writer is back: frames that were on the way are sent again")] if event.came_back else []
        said: list[Action] = [] if event.reserved else [Say("this file system cannot reserve space: watch the disk")]
        if self.settings.resume is not None:
            self.shooting.paired |= self.window.committed.keys()
            self._first_pixels = self.settings.resume.first
            return said + self._warm_up(now_ns)
        if not self.settings.dark_frames:
            return said + self._warm_up(now_ns)
        self.phase = Phase.AMBIENT
        self._deadline_ns = now_ns + self.settings.exposure_ns + self.settings.frame_timeout_ns
        return [*said, SetLamp(on=False), Snap()]

    def _take_ambient(self, event: CameraFrame, now_ns: int) -> list[Action]:
        if what_is_wrong(event, self.settings.format):
            self.counters["damaged"] += 1
            return self._warm_up(now_ns)
        image = image_of_snap(event, "ambient", self.position_steps, self.settings)
        return [Publish(image, event.pixels), *self._warm_up(now_ns)]

    def _warm_up(self, now_ns: int) -> list[Action]:
        self.phase = Phase.WARM_UP
        self._deadline_ns = now_ns + round(self.settings.warm_up_ns * self.settings.time_scale)
        return [SetLamp(on=True)]

    def _after_warm_up(self, now_ns: int) -> list[Action]:
        resume = self.settings.resume
        if resume is None:
            return self._next_segment(now_ns)
        self.phase = Phase.OVERLAP
        self._moving_until(now_ns)
        return self.shooting.begin(resume.last_frame, resume.last_frame, now_ns, gated=False)

    def _take_overlap(self, event: CameraFrame, shot: Shot) -> list[Action]:
        """Go on only if the rig still shows what it showed (decided here, said when the stage rests)."""
        resume = self.settings.resume
        assert resume is not None
        found = compare_overlap(resume.stored, event.pixels, resume.before, self.settings.plan.pitch_steps)
        self.checks |= found.as_checks()
        self._complaint = found.complaint(resume.limits)
        return [
            *self._offer(event, shot, "overlap"),
            Attach("overlap.png", overlap_picture(resume.stored, event.pixels)),
        ]

    def _after_overlap(self, now_ns: int) -> list[Action]:
        if not self._complaint:
            return [Say("the rig is where it was: the sweep goes on"), *self._next_segment(now_ns)]
        fault = self._report("F01")
        told = msgspec.structs.replace(
            fault,
            happened=f"the scan cannot go on: {self._complaint} (overlap.png beside the scan shows it)",
            to_do="put it back, or home the stage, and resume; or close the scan: 'sweepscope recover --seal'",
        )
        return [RaiseFault(told), *self._end_early(Outcome.INTERRUPTED, f"overlap check: {self._complaint}", now_ns)]

    # ---- shots ----

    def _next_segment(self, now_ns: int) -> list[Action]:
        run = self.shooting.next_run()
        if run is None:
            return self._repeat_first(now_ns)
        self.phase = Phase.RUN
        self._moving_until(now_ns)
        return self.shooting.begin(*run, now_ns)

    def _on_triggered(self, event: Triggered, now_ns: int) -> list[Action]:
        self.position_steps, self.silent = event.position_steps, False
        self.counters["triggered" if self.phase not in _CHECKS else "check_triggers"] += 1
        wrong = self.shooting.triggered(event, now_ns)
        if wrong:
            return self._give_up(Outcome.FAILED, wrong, "F15", now_ns)
        self._expect_stage(now_ns)
        return []

    def _on_frame(self, event: CameraFrame, now_ns: int) -> list[Action]:
        self.counters["received" if self.phase not in _CHECKS else "check_frames"] += 1
        if self._deaf:
            return []
        if self.phase is Phase.AMBIENT:
            return self._take_ambient(event, now_ns)
        pairing = self.shooting.ledger.frame(event.camera_frame_id, event.exposure_start_ns)
        actions = self._lose(pairing.lost, "its frame did not come", "F16", now_ns)
        if pairing.shot is None:
            self.counters["extra"] += 1
            return actions + self._tell_of_extra()
        wrong = what_is_wrong(event, self.settings.format)
        if wrong:
            self.counters["damaged"] += 1
            return actions + self._lose((pairing.shot,), wrong, "F19", now_ns)
        return actions + self._take(event, pairing.shot, now_ns)

    def _tell_of_extra(self) -> list[Action]:
        count = self.counters["extra"]
        return [RaiseFault(self._report("F17", count=count))] if is_worth_saying(count) else []

    def _take(self, event: CameraFrame, shot: Shot, now_ns: int) -> list[Action]:
        if self.phase is Phase.REPEAT:
            assert self._first_pixels is not None
            self.checks |= measure_drift(self._first_pixels, event.pixels)
            return self._offer(event, shot, "repeat")
        if self.phase is Phase.OVERLAP:
            return self._take_overlap(event, shot)
        self.shooting.paired.add(shot.frame_index)
        if shot.frame_index == 0:
            self._first_pixels = event.pixels
        return [*self._offer(event, shot), *self._look_at_light(event, shot.frame_index), *self._grant(now_ns)]

    def _offer(self, event: CameraFrame, shot: Shot, role: Role = "sweep") -> list[Action]:
        """On its way at once, or when the controller has been heard after the exposure."""
        publish = Publish(image_of_shot(event, shot, self.settings, role), event.pixels)
        began_ns = event.exposure_start_ns or shot.at_mono_ns
        return [*self._unproven.add(publish, began_ns + self.settings.exposure_ns)]

    def _drop_doubtful(self) -> None:
        """The controller stopped by itself: what was not proven before may show it: it is taken again, or missing."""
        for frame_index in self._unproven.drop():
            self.counters["doubtful"] += 1
            self.shooting.paired.discard(frame_index)
        self.counters["doubtful"] += len(self.shooting.ledger.drop_all())
        self._deaf = True

    def _look_at_light(self, event: CameraFrame, frame_index: int) -> list[Action]:
        """In another light S is wrong for every pixel: hold, and let the operator decide."""
        found = None if self.paused else self._light.update(frame_index, event.pixels)
        if found is None:
            return []
        first, what = found
        self._light.forget()
        self.checks.setdefault("light_changed_at", float(first))
        self.paused = self._light_is_judged = True
        fault = self._report("F27", detail=f"{what} since frame {first}")
        mark = Mark({"light_changed_at": self.checks["light_changed_at"]})
        return [RaiseFault(fault), mark, *([HoldStage()] if self.phase is Phase.RUN else [])]

    def _grant(self, now_ns: int) -> list[Action]:
        if self.phase is not Phase.RUN or self.paused:
            return []
        actions = self.shooting.grant()
        self._expect_stage(now_ns)
        return actions

    def _lose(self, shots: tuple[Shot, ...], detail: str, code: str, now_ns: int) -> list[Action]:
        """Take lost frames again; too many attempts are a fault."""
        if self.phase in (Phase.REPEAT, Phase.OVERLAP) or not shots:
            return []
        attempts = self.shooting.attempts
        for shot in shots:
            self.counters["lost"] += 1
            lost = attempts[shot.frame_index] = attempts.get(shot.frame_index, 0) + 1
            if lost >= self.settings.max_attempts:
                fault = self._report(code, frame=shot.frame_index, attempts=lost, detail=detail)
                return [RaiseFault(fault), *self._end_early(Outcome.FAILED, f"{code} {fault.happened}", now_ns)]
        if self.phase is not Phase.RUN:
            return []
        return [Say(f"frame {shots[0].frame_index} is taken again: {detail}"), *self._stop_segment(now_ns)]

    def _on_camera_gone(self, event: CameraGone, now_ns: int) -> list[Action]:
        if event.back:
            return []
        lost = self.shooting.ledger.drop_all()
        return [RaiseFault(self._report("F18")), *self._lose(lost, event.detail, "F18", now_ns)]

    # ---- the stage rests ----

    def _on_rest(self, event: SegmentDone | Moved | Stopped, now_ns: int) -> list[Action]:
        self.position_steps, self._resting, self._deadline_ns = event.position_steps, True, None
        self.silent = False
        self.shooting.segment_done = True
        if self.phase is Phase.LIMIT:
            if isinstance(event, Moved) and event.steps_lost is not None:
                self.checks["steps_lost"] = float(event.steps_lost)
            return self._drain(now_ns)
        return []

    def _stop_segment(self, now_ns: int) -> list[Action]:
        """Frames that are on their way are still taken; what follows is decided when the stage rests."""
        self.phase = Phase.STOPPING
        if self._resting:
            return []
        self._moving_until(now_ns)
        return [StopStage()]

    def _after_stop(self, now_ns: int) -> list[Action]:
        if self.outcome is not Outcome.RUNNING:
            return [Disarm(), *self._drain(now_ns)]
        return [] if self.paused else self._next_segment(now_ns)

    # ---- checks after the last frame ----

    def _repeat_first(self, now_ns: int) -> list[Action]:
        if self._skip_checks or not self.settings.repeat_first or self._first_pixels is None:
            return self._check_limit(now_ns)
        self.phase = Phase.REPEAT
        self._moving_until(now_ns)
        return self.shooting.begin(0, 0, now_ns, gated=False)

    def _check_limit(self, now_ns: int) -> list[Action]:
        if self._skip_checks or not self.settings.check_limit:
            return [Disarm(), *self._drain(now_ns)]
        self.phase = Phase.LIMIT
        self._moving_until(now_ns)
        return [Disarm(), CheckLimit()]

    # ---- the end ----

    def _end_early(self, outcome: Outcome, reason: str, now_ns: int) -> list[Action]:
        if self.outcome is not Outcome.RUNNING or self.phase in (Phase.DRAIN, Phase.SEAL):
            return []
        self.paused = self.shooting.short_of_credit = False
        if self.phase in (Phase.REPEAT, Phase.LIMIT) and outcome is Outcome.STOPPED:
            self._skip_checks = True  # all frames are there: only the checks end early
        else:
            self.outcome, self.reason = outcome, reason
        return self._stop_segment(now_ns)

    def _give_up(self, outcome: Outcome, detail: str, code: str, now_ns: int) -> list[Action]:
        fault = self._report(code, detail=detail)
        return [RaiseFault(fault), *self._end_early(outcome, f"{code} {detail}", now_ns)]

    def _drain(self, now_ns: int) -> list[Action]:
        """Every frame that was taken must be committed before the end is said."""
        self.phase = Phase.DRAIN
        self._deadline_ns = now_ns + self.settings.seal_ns
        return []

    def _finish(self, now_ns: int) -> list[Action]:
        # an interrupted sweep is not sealed, so that it can go on another time; the file learns why it was
        self.phase = Phase.SEAL
        # without a writer there is nothing to seal: one that is slow to come is waited for as at the start
        self._deadline_ns = now_ns + (self.settings.seal_ns if self._has_writer else self.settings.writer_start_ns)
        if self.outcome is Outcome.RUNNING:
            self.outcome = Outcome.COMPLETE if self.window.prefix == self.count else Outcome.FAILED
        end = end_of_sweep(
            self.outcome,
            self._reason_with_light(),
            settings=self.settings,
            sent=len(self.shooting.paired),
            window=self.window,
            retaken=[k for k in self.shooting.attempts if k in self.window.committed],
            counters=self.accounts(),
            checks=self.checks,
        )
        return [Finish(end)]

    def _reason_with_light(self) -> str:
        """Frames that were taken in another light are marked by it, in the end message and in the file."""
        changed_at = self.checks.get("light_changed_at")
        note = "" if changed_at is None else f"F27 the light changed at frame {changed_at:.0f}"
        return "; ".join(filter(None, (self.reason, note)))

    def accounts(self) -> dict[str, int]:
        """Every counter of the sweep, by name."""
        return self.counters | {"conflicts": self.window.conflicts, "holds_no_credit": self.shooting.holds}

    def _on_sealed(self, event: Sealed, now_ns: int) -> list[Action]:
        if self.phase is not Phase.SEAL:
            return []
        self.phase, self.result = Phase.DONE, event
        if self.outcome is Outcome.INTERRUPTED:
            return []
        if event.end_ack.sealed:
            self.durable = len(self.window.committed)
            return []
        self.outcome, self.reason = Outcome.INTERRUPTED, event.end_ack.reason
        return [RaiseFault(self._report("F07", detail=event.end_ack.reason))]

    def _abandon(self, outcome: Outcome, reason: str, fault: FaultReport) -> list[Action]:
        """There is nobody to say an end to."""
        self.outcome, self.reason, self.phase = outcome, reason, Phase.DONE
        return [StopStage(), Disarm(), RaiseFault(fault)]

    # ---- operator and writer ----

    def _on_pause(self, event: PauseRequested, now_ns: int) -> list[Action]:
        if not self.can_pause or self.paused:
            return []
        self.paused = True
        return [HoldStage()] if self.phase is Phase.RUN else []

    def _on_resume(self, event: ResumeRequested, now_ns: int) -> list[Action]:
        if not self.paused:
            return []
        self.paused = False
        if self._light_is_judged:
            self._light_is_judged = False
            self._light.forget()
        if self.phase is Phase.RUN:
            return [ResumeStage(), *self._grant(now_ns)]
        return []

    def _on_stop(self, event: StopRequested, now_ns: int) -> list[Action]:
        return self._end_early(event.outcome, event.reason, now_ns)

    def _on_alarm(self, event: Alarm, now_ns: int) -> list[Action]:
        # the controller stands already: nothing more will be heard of the activity
        self.silent = False
        self._drop_doubtful()
        self.position_steps, self._resting, self.shooting.segment_done = event.position_steps, True, True
        outcome = Outcome.INTERRUPTED if event.code in _CAN_BE_RESUMED else Outcome.ABORTED
        return self._give_up(outcome, event.detail, event.code, now_ns)

    def _on_committed(self, event: Committed, now_ns: int) -> list[Action]:
        self.durable = event.durable_count
        return self._grant(now_ns)

    def _on_refused(self, event: Refused, now_ns: int) -> list[Action]:
        nack = event.nack
        detail = f"{nack.reason}{': ' if nack.detail else ''}{nack.detail}"
        fault = self._report("F06" if nack.reason == "no space" else "F07", detail=detail)
        if self.phase is Phase.WAIT_WRITER:
            return self._abandon(Outcome.FAILED, detail, fault)
        if nack.reason in _FOR_GOOD and nack.frame_index >= 0:
            # a check frame may be there from before an interruption; a frame of the sweep blocks all that follow
            return [] if nack.role != "sweep" else self._give_up(Outcome.FAILED, detail, "F07", now_ns)
        if nack.reason in _DAMAGED:
            fault = self._report(
                "F19", frame=nack.frame_index, attempts=1, detail=f"on its way to the writer: {detail}"
            )
        return [] if nack.reason in _NO_FAULT else [RaiseFault(fault)]

    def _on_held(self, event: Held, now_ns: int) -> list[Action]:
        self.position_steps = event.position_steps
        if event.reason not in _SILENCES:
            return []
        self.silent = True
        return [RaiseFault(self._report(_SILENCES[event.reason], detail="it is waited for"))]

    # ---- time ----

    def _on_tick(self, event: Tick, now_ns: int) -> list[Action]:
        proven: list[Action] = [*self._unproven.proven(event.sound_ns)]
        self._just_proven = bool(proven)
        late = self.shooting.ledger.overdue(now_ns)
        if late:
            return proven + self._lose(late, "its frame did not come in time", "F16", now_ns)
        if self._deadline_ns is None or now_ns < self._deadline_ns:
            return proven
        self._deadline_ns = None
        return proven + self._time_is_up(now_ns)

    def _time_is_up(self, now_ns: int) -> list[Action]:
        if self.phase is Phase.WARM_UP:
            return self._after_warm_up(now_ns)
        if self.phase is Phase.AMBIENT:
            return [Say("no ambient frame came: the camera does not answer"), *self._warm_up(now_ns)]
        if self.phase is Phase.WAIT_WRITER or (self.phase is Phase.SEAL and not self._has_writer):
            seconds = f"{self.settings.writer_start_ns / NS_PER_S:g}"
            return self._abandon(Outcome.FAILED, "no writer made the file ready", self._report("F05", seconds=seconds))
        if self.phase in (Phase.DRAIN, Phase.SEAL):
            reason = self.reason if self.outcome is Outcome.INTERRUPTED else "F03 the writer did not seal in time"
            return self._abandon(Outcome.INTERRUPTED, reason, self._report("F03"))
        self._resting = True  # nothing is waited for any more; what it still hears, it shall do
        self._drop_doubtful()
        self.shooting.segment_done = True
        return [StopStage(), *self._give_up(Outcome.INTERRUPTED, "the stage does not answer", "F12", now_ns)]

    def _moving_until(self, now_ns: int) -> None:
        self._resting = False
        self._deadline_ns = now_ns + self.settings.motion_ns

    def _expect_stage(self, now_ns: int) -> None:
        """The stage must answer by the deadline only while it has something to do."""
        waiting = self.shooting.awaits_trigger() and not self.paused
        self._deadline_ns = now_ns + self.settings.motion_ns if waiting else None

    def _look_around(self, now_ns: int) -> list[Action]:
        """What follows from the state of things, whichever event brought it about."""
        ready = self.shooting.segment_done and not self.shooting.ledger.pending
        if self.phase is Phase.RUN and ready and not self.paused:
            return self._next_segment(now_ns)
        if self.phase is Phase.OVERLAP and ready:
            return self._after_overlap(now_ns)
        if self.phase is Phase.REPEAT and ready:
            return self._check_limit(now_ns)
        if self.phase is Phase.STOPPING and self._resting and not self.shooting.ledger.pending:
            return self._after_stop(now_ns)
        if self.phase is Phase.DRAIN and not self._unproven and not self._just_proven and self.window.is_settled():
            return self._finish(now_ns)
        return []

    def _report(self, code: str, **facts: object) -> FaultReport:
        return report(code, 0, committed=len(self.window.committed), expected=self.count, **facts)


_HANDLERS: dict[type, Callable[[Sweep, Any, int], list[Action]]] = {
    WriterReady: Sweep._on_writer_ready,
    Committed: Sweep._on_committed,
    Refused: Sweep._on_refused,
    Sealed: Sweep._on_sealed,
    Triggered: Sweep._on_triggered,
    SegmentDone: Sweep._on_rest,
    Moved: Sweep._on_rest,
    Stopped: Sweep._on_rest,
    Held: Sweep._on_held,
    Alarm: Sweep._on_alarm,
    CameraFrame: Sweep._on_frame,
    CameraGone: Sweep._on_camera_gone,
    PauseRequested: Sweep._on_pause,
    ResumeRequested: Sweep._on_resume,
    StopRequested: Sweep._on_stop,
    Tick: Sweep._on_tick,
}
