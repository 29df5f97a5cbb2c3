"""The sweep as a pure state machine: events in, actions out.

It promises that every frame index is either committed or named as missing, that the stage ends stopped, and that
nothing ends as complete that is not. Here stands what each event means; each part of the promise is kept in a file:

- `opening`: nothing moves before the file is there;
- `course`: the stage goes on until each frame is taken, or is stopped; `shooting`: no credit, no trigger;
- `intake`: each frame is taken once and for its own trigger, or named as lost; `checks`: the light is known;
- `closing`: the end is true.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from acquire.cameras.protocol import CameraFrame, CameraGone
from acquire.contract.process.log_throttle import is_worth_saying
from acquire.contract.states import HoldReason, Outcome, State
from acquire.stages.protocol import Alarm, Held, Moved, SegmentDone, Stopped, Triggered

from .actions import Action, HoldStage, Mark, RaiseFault, ResumeStage, Say, StopStage
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
from .finish import Closing
from .frame_intake import Intake, Loss
from .pairing import Shot
from .phases import CHECKING, Deadline, Phase, rig_state
from .progress import Shooting
from .self_checks import LIGHT_CHANGED_AT, Checks
from .stage_motion import Course
from .startup import Opening
from .writer_nacks import understand

_CAN_BE_RESUMED = frozenset({"F12", "F13", "F15"})
"""Alarms after which the specimen and the frames are as they were: the scan stays partial."""
_SILENCES = {"lease": "F15", "link lost": "F12"}
"""Holds of the controller's own making, and the faults that they are."""


@dataclass
class Sweep:
    """One sweep from its start to its sealed end."""

    shooting: Shooting
    silent: bool = False
    """The controller holds because it did not hear the host, or is gone; it goes on by itself when it does."""
    position_steps: int = 0
    """Where the stage was last heard of, in microsteps."""
    _durable: int = 0

    def __post_init__(self) -> None:
        self.settings, self.window = self.shooting.settings, self.shooting.window
        self.count = self.settings.plan.count
        self.checks = Checks(self.settings)
        self.intake = Intake(self.shooting)
        self.opening = Opening(self.settings)
        self.closing = Closing(self.shooting, self.intake, self.checks)
        self.course = Course(self.shooting, self.checks, self.closing)

    # ---- the door ----

    def start(self, now_ns: int) -> None:
        """The writer was told to make the file; nothing moves until it has."""
        self.opening.start(now_ns)

    def handle(self, event: SweepEvent, now_ns: int) -> list[Action]:
        """Take one event and say what is to be done about it, in order."""
        if self.phase is Phase.DONE:
            return []
        said = _HANDLERS[type(event)](self, event, now_ns)
        follows = self.course if self.closing.phase is None else self.closing
        return said + follows.look_around(now_ns)

    @property
    def phase(self) -> Phase:
        """Where it is between start and end."""
        return self.closing.phase or self.course.phase or self.opening.phase

    @property
    def outcome(self) -> Outcome:
        """How it ends; running as long as nothing has decided that."""
        return self.closing.outcome

    @property
    def paused(self) -> bool:
        """True from a pause, or a change of the light, until the operator resumes it."""
        return self.course.paused

    @property
    def away(self) -> bool:
        """True while the camera is gone; the sweep goes on by itself when it is back."""
        return self.course.away

    @property
    def state(self) -> State:
        """The rig's state that belongs to the phase."""
        holding = self.paused or self.silent or self.away or self.shooting.short_of_credit
        return rig_state(self.phase, holding=holding)

    @property
    def hold_reason(self) -> HoldReason | None:
        """Why it holds; None when it does not."""
        if self.state is not State.HOLDING:
            return None
        if self.paused:
            return HoldReason.PAUSED
        if self.silent:
            return HoldReason.LINK_LOST
        return HoldReason.CAMERA_AWAY if self.away else HoldReason.NO_CREDIT

    @property
    def can_pause(self) -> bool:
        """True while frames are being taken."""
        return self.phase in (Phase.RUN, Phase.STOPPING) and self.outcome is Outcome.RUNNING

    @property
    def durable(self) -> int:
        """Frames that survive a power cut."""
        return len(self.window.committed) if self.closing.is_sealed else self._durable

    # ---- triggers and frames ----

    def _on_triggered(self, event: Triggered, now_ns: int) -> list[Action]:
        self.position_steps, self.silent = event.position_steps, False
        wrong = self.intake.triggered(event, now_ns, check=self.phase in CHECKING)
        if wrong:
            return self._give_up(Outcome.FAILED, wrong, "F15", now_ns)
        self.course.expect_stage(now_ns)
        return [action for frame in self.intake.early(now_ns) for action in self._pair(frame, now_ns, was_early=True)]

    def _on_frame(self, event: CameraFrame, now_ns: int) -> list[Action]:
        self.intake.count_frame(check=self.phase in CHECKING)
        if self.phase is Phase.AMBIENT:
            return [*self.intake.take_ambient(event, self.position_steps), *self.opening.ambient_came(now_ns)]
        return [] if self.intake.is_early(event, now_ns) else self._pair(event, now_ns)

    def _pair(self, event: CameraFrame, now_ns: int, *, was_early: bool = False) -> list[Action]:
        arrival = self.intake.pair(event, was_early=was_early)
        actions: list[Action] = []
        for loss in arrival.losses:
            actions += self._lose(loss, now_ns)
        if arrival.extra:
            actions += self._tell_of_extra()
        return actions if arrival.shot is None else actions + self._take(event, arrival.shot, now_ns)

    def _take(self, event: CameraFrame, shot: Shot, now_ns: int) -> list[Action]:
        if self.phase is Phase.REPEAT:
            self.checks.compare_first(event.pixels)
            return [*self.intake.take(event, shot, "repeat")]
        if self.phase is Phase.OVERLAP:
            # decided here, said when the stage rests
            picture = self.checks.compare_overlap(event.pixels)
            return [*self.intake.take(event, shot, "overlap"), picture]
        taken = self.intake.take(event, shot)
        return [*taken, *self._look_at_light(event, shot.frame_index), *self.course.go_on(now_ns)]

    def _look_at_light(self, event: CameraFrame, frame_index: int) -> list[Action]:
        """In another light S is wrong for every pixel: hold, and let the operator decide."""
        changed = self.checks.look_at(frame_index, event.pixels, watch=not self.paused)
        if not changed:
            return []
        self.course.paused = True
        mark = Mark({LIGHT_CHANGED_AT: self.checks.measured[LIGHT_CHANGED_AT]})
        hold = [HoldStage()] if self.phase is Phase.RUN else []
        return [RaiseFault(self.shooting.fault("F27", detail=changed)), mark, *hold]

    def _lose(self, loss: Loss, now_ns: int) -> list[Action]:
        """Take lost frames again; too many attempts are a fault."""
        if self.phase in (Phase.REPEAT, Phase.OVERLAP) or not loss.shots:
            return []
        for shot in loss.shots:
            attempts = self.intake.count_lost(shot)
            if attempts >= self.settings.max_attempts:
                fault = self.shooting.fault(loss.code, frame=shot.frame_index, attempts=attempts, detail=loss.detail)
                ending = self.course.end_early(Outcome.FAILED, f"{loss.code} {fault.happened}", now_ns)
                return [RaiseFault(fault), *ending]
        if self.phase is not Phase.RUN:
            return []
        told = Say(f"frame {loss.shots[0].frame_index} is taken again: {loss.detail}")
        return [told, *self.course.stop_run(now_ns)]

    def _tell_of_extra(self) -> list[Action]:
        count = self.intake.counters["extra"]
        return [RaiseFault(self.shooting.fault("F17", count=count))] if is_worth_saying(count) else []

    def _on_camera_gone(self, event: CameraGone, now_ns: int) -> list[Action]:
        if event.back:
            said: list[Action] = [Say("the camera is back: frames that were lost are taken again")] if self.away else []
            self.course.away = False
            return said
        told: list[Action] = [] if self.away else [RaiseFault(self.shooting.fault("F18", detail=event.detail))]
        lost = self._lose(self.intake.camera_gone(event.detail), now_ns)
        return [*told, *lost, *self.course.camera_gone(now_ns)]

    # ---- the stage's other words ----

    def _on_rest(self, event: SegmentDone | Moved | Stopped, now_ns: int) -> list[Action]:
        self.position_steps, self.silent = event.position_steps, False
        return self.course.rest(event.steps_lost if isinstance(event, Moved) else None, now_ns)

    def _on_held(self, event: Held, now_ns: int) -> list[Action]:
        self.position_steps = event.position_steps
        if event.reason not in _SILENCES:
            return []
        self.silent = True
        return [RaiseFault(self.shooting.fault(_SILENCES[event.reason], detail="it is waited for"))]

    def _on_alarm(self, event: Alarm, now_ns: int) -> list[Action]:
        # the controller stands already: nothing more will be heard of the activity
        self.position_steps, self.silent = event.position_steps, False
        self.intake.distrust()
        self.course.halt()
        outcome = Outcome.INTERRUPTED if event.code in _CAN_BE_RESUMED else Outcome.ABORTED
        return self._give_up(outcome, event.detail, event.code, now_ns)

    def _give_up(self, outcome: Outcome, detail: str, code: str, now_ns: int) -> list[Action]:
        fault = self.shooting.fault(code, detail=detail)
        return [RaiseFault(fault), *self.course.end_early(outcome, f"{code} {detail}", now_ns)]

    # ---- the operator ----

    def _on_pause(self, event: PauseRequested, now_ns: int) -> list[Action]:
        if not self.can_pause or self.paused:
            return []
        self.course.paused = True
        return [HoldStage()] if self.phase is Phase.RUN else []

    def _on_resume(self, event: ResumeRequested, now_ns: int) -> list[Action]:
        if not self.paused:
            return []
        self.course.paused = False
        self.checks.accept_light()
        return [ResumeStage(), *self.course.go_on(now_ns)] if self.phase is Phase.RUN else []

    def _on_stop(self, event: StopRequested, now_ns: int) -> list[Action]:
        return self.course.end_early(event.outcome, event.reason, now_ns)

    # ---- the writer ----

    def _on_writer_ready(self, event: WriterReady, now_ns: int) -> list[Action]:
        self.closing.writer_ready(now_ns)
        if self.phase is not Phase.WAIT_WRITER:
            return [Say("the writer is back: frames that were on the way are sent again")] if event.came_back else []
        if self.settings.resume is not None:
            self.shooting.paired |= self.window.committed.keys()
        return self.opening.writer_ready(event, now_ns)

    def _on_committed(self, event: Committed, now_ns: int) -> list[Action]:
        self._durable = event.durable_count
        return self.course.go_on(now_ns)

    def _on_refused(self, event: Refused, now_ns: int) -> list[Action]:
        refusal = understand(event.nack, has_file=self.phase is not Phase.WAIT_WRITER)
        if not refusal.code:
            return []
        fault = self.shooting.fault(refusal.code, detail=refusal.detail, **refusal.facts)
        if self.phase is Phase.WAIT_WRITER:
            return self.closing.abandon(Outcome.FAILED, refusal.detail, fault)
        if refusal.ends_sweep:
            return self._give_up(Outcome.FAILED, refusal.detail, refusal.code, now_ns)
        return [RaiseFault(fault)]

    def _on_sealed(self, event: Sealed, now_ns: int) -> list[Action]:
        return self.closing.sealed(event)

    # ---- time ----

    def _on_tick(self, event: Tick, now_ns: int) -> list[Action]:
        proven: list[Action] = [*self.intake.proven(event.sound_ns)]
        if self.course.camera_is_missed(now_ns):
            proven += self._give_up(Outcome.INTERRUPTED, "it did not come back", "F18", now_ns)
        late = self.intake.overdue(now_ns)
        if late is not None:
            return proven + self._lose(late, now_ns)
        return proven + (self._time_is_up(now_ns) if self._deadline.passed(now_ns) else [])

    @property
    def _deadline(self) -> Deadline:
        """What is waited for now: each part has its own, so that no late word of one ends the wait for another."""
        if self.closing.phase is not None:
            return self.closing.deadline
        return self.opening.deadline if self.course.phase is None else self.course.deadline

    def _time_is_up(self, now_ns: int) -> list[Action]:
        if self.closing.phase is not None:
            return self.closing.time_is_up()
        if self.phase is Phase.WAIT_WRITER:
            return self.closing.abandon_without_writer()
        if self.course.phase is None:
            said = self.opening.time_is_up(now_ns)
            return said + self.course.begin(now_ns) if self.opening.over else said
        self.intake.distrust()
        self.course.halt()  # what it still hears, it shall do
        return [StopStage(), *self._give_up(Outcome.INTERRUPTED, "the stage does not answer", "F12", now_ns)]


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
