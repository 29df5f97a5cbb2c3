"""The state machine of one sweep: events in, actions out. Pure: no device, socket or clock, and nothing is shared.

It guarantees that every frame is either committed or named as missing, that the stage ends stopped, and that nothing
ends as complete that is not. It has one phase, which changes only by the table in :mod:`acquire.sweep.phases`, and one
deadline.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec

from acquire.cameras.protocol import CameraFrame, CameraGone
from acquire.contract.faults import report
from acquire.contract.messaging.messages import FaultReport
from acquire.contract.process.log_throttle import is_worth_saying
from acquire.contract.states import HoldReason, Outcome, State
from acquire.contract.units import NS_PER_S
from acquire.stages.protocol import Alarm, Held, Moved, SegmentDone, Stopped, Triggered

from .actions import (
    Action,
    Arm,
    BeginSegment,
    CheckLimit,
    Disarm,
    Grant,
    HoldStage,
    Publish,
    RaiseFault,
    ResumeStage,
    SaveMarks,
    Say,
    SendEnd,
    SetLamp,
    Snap,
    StopStage,
)
from .checks.self_checks import SelfChecks
from .credit_window import CreditWindow
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
from .finish import Finish
from .frame_intake import FrameIntake, Loss
from .phases import CHECK_PHASES, STAGE_PHASES, Decision, Phase, next_phase, rig_state
from .retakes import Retakes
from .settings import SweepSettings
from .writer_nacks import understand

_CAN_BE_RESUMED = frozenset({"F12", "F13", "F15"})
"""Alarms after which the specimen and the frames are as they were: the scan stays partial."""
_SILENCES = {"lease": "F15", "link lost": "F12"}
"""Holds of the controller's own making, and the faults that they are."""


@dataclass
class Sweep:
    """One sweep from its start to its sealed end."""

    settings: SweepSettings
    slots: int
    """Frames that may be uncommitted at a time."""
    position_steps: int = 0
    """The last known position of the stage, in microsteps."""
    phase: Phase = Phase.WAIT_WRITER
    deadline_ns: int | None = None
    """By when the awaited answer must be there; None while no answer is awaited."""
    paused: bool = False
    """True from a pause, or a change of the light, until the operator resumes the sweep."""
    silent: bool = False
    """The controller holds because it lost contact with the host; it goes on by itself."""

    def __post_init__(self) -> None:
        self.count = self.settings.plan.count
        self.window = CreditWindow(self.slots)
        self.retakes = Retakes(self.count, self.settings.max_attempts)
        self.intake = FrameIntake(self.settings)
        self.checks = SelfChecks(self.settings)
        self.finish = Finish()
        self._at_rest = True
        """The stage stands, or no answer of it is awaited any more."""
        self._camera_gone_ns: int | None = None
        """Since when the camera is gone; None while it is there."""
        self._skip_checks = False
        self._durable = 0

    def start(self, now_ns: int) -> None:
        """The writer was told to make the file; nothing moves until it has."""
        self.deadline_ns = now_ns + self.settings.writer_start_ns

    def handle(self, event: SweepEvent, now_ns: int) -> list[Action]:
        """Take one event; returns the actions that it causes, in order.

        Raises:
            IllegalTransitionError: a bug: the table of phases has no such transition.
        """
        if self.phase is Phase.DONE:
            return []
        actions = _HANDLERS[type(event)](self, event, now_ns)
        if self.phase is Phase.DRAIN:
            return actions + self._seal_if_settled(now_ns)
        if self.phase in STAGE_PHASES and self._at_rest and not self.intake.pairing.pending:
            return actions + self._next_motion(now_ns)
        return actions

    # ---- what the daemon shows ----

    @property
    def outcome(self) -> Outcome:
        """How it ends; running as long as nothing has decided that."""
        return self.finish.outcome

    @property
    def away(self) -> bool:
        """True while the camera is gone; the sweep goes on by itself when it is back."""
        return self._camera_gone_ns is not None

    @property
    def state(self) -> State:
        """The rig's state that belongs to the phase."""
        return rig_state(self.phase, holding=self.paused or self.silent or self.away or self.window.short)

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
        return self.phase in (Phase.RUN, Phase.STOPPING) and not self.finish.is_decided

    @property
    def durable(self) -> int:
        """Frames that survive a power cut."""
        return len(self.window.committed) if self.finish.is_sealed else self._durable

    @property
    def retaken(self) -> int:
        """Frames that were lost at least once and are committed."""
        return sum(1 for k in self.retakes.attempts if k in self.window.committed)

    @property
    def counters(self) -> dict[str, int]:
        """Every counter of the sweep, by name."""
        window = self.window
        more = {"lost": self.retakes.lost, "conflicts": window.conflicts, "holds_no_credit": window.holds}
        return self.intake.counters | more

    # ---- triggers and frames ----

    def _on_triggered(self, event: Triggered, now_ns: int) -> list[Action]:
        self.position_steps, self.silent = event.position_steps, False
        self.intake.counters["check_triggers" if self.phase in CHECK_PHASES else "triggered"] += 1
        window, frame_index = self.window, self.window.first + event.shot_index
        planned = self.settings.plan.position_steps(frame_index)
        if event.position_steps != planned or not window.first <= frame_index <= window.granted:
            wrong = f"frame {frame_index} was triggered at {event.position_steps} microsteps, planned {planned}"
            return self._give_up(Outcome.FAILED, wrong, "F15", now_ns)
        window.triggered_through = max(window.triggered_through, frame_index)
        self.intake.triggered(event, frame_index, self.retakes.attempts.get(frame_index, 0), now_ns)
        self._expect_stage(now_ns)
        early = self.intake.early(now_ns)
        return [action for frame in early for action in self._take_frame(frame, now_ns, was_early=True)]

    def _on_frame(self, event: CameraFrame, now_ns: int) -> list[Action]:
        self.intake.counters["check_frames" if self.phase in CHECK_PHASES else "received"] += 1
        if self.phase is Phase.AMBIENT:
            return [*self._send(self.intake.publish_ambient(event, self.position_steps)), *self._light_lamp(now_ns)]
        if self.window.running and self.intake.keep_early(event, now_ns):
            return []
        return self._take_frame(event, now_ns)

    def _take_frame(self, frame: CameraFrame, now_ns: int, *, was_early: bool = False) -> list[Action]:
        arrival = self.intake.pair(frame, was_early=was_early)
        actions = [action for loss in arrival.losses for action in self._retake(loss, now_ns)]
        if arrival.extra:
            actions += self._tell_of_extra()
        shot = arrival.shot
        if shot is None:
            return actions
        if self.phase is Phase.REPEAT:
            self.checks.compare_first(frame.pixels)
            return actions + self._send(self.intake.publish(frame, shot, "repeat"))
        if self.phase is Phase.OVERLAP:
            picture = self.checks.compare_overlap(frame.pixels)
            return [*actions, *self._send(self.intake.publish(frame, shot, "overlap")), picture]
        self.retakes.taken.add(shot.frame_index)
        actions += self._send(self.intake.publish(frame, shot, "sweep"))
        return actions + self._watch_light(frame, shot.frame_index) + self._grant(now_ns)

    def _send(self, frames: list[Publish]) -> list[Action]:
        for frame in frames:
            self.window.publish(frame.image)
        return [*frames]

    def _watch_light(self, frame: CameraFrame, frame_index: int) -> list[Action]:
        """In another light S is wrong for every pixel: hold, and let the operator decide."""
        if frame_index == 0:
            self.checks.first = frame.pixels
        found = None if self.paused else self.checks.light.update(frame_index, frame.pixels)
        if found is None:
            return []
        since, change = found
        fault = RaiseFault(self._fault("F27", detail=f"{change} since frame {since}"))
        return [fault, SaveMarks(self.checks.note_light_change(since)), *self._hold()]

    def _retake(self, loss: Loss, now_ns: int) -> list[Action]:
        """Take lost frames again, which needs a new run; a frame that is lost too often is a fault."""
        if self.phase in (Phase.REPEAT, Phase.OVERLAP) or not loss.shots:
            return []
        worst = self.retakes.lose(loss.shots)
        if worst is not None:
            facts = {"frame": worst.frame_index, "attempts": self.retakes.attempts[worst.frame_index]}
            fault = self._fault(loss.code, detail=loss.detail, **facts)
            return [RaiseFault(fault), *self._end_early(Outcome.FAILED, f"{loss.code} {fault.happened}", now_ns)]
        if self.phase is not Phase.RUN:
            return []
        told = Say(f"frame {loss.shots[0].frame_index} is taken again: {loss.detail}")
        return [told, *self._stop_stage(Decision.RETAKE, now_ns)]

    def _tell_of_extra(self) -> list[Action]:
        count = self.intake.counters["extra"]
        return [RaiseFault(self._fault("F17", count=count))] if is_worth_saying(count) else []

    def _on_camera_gone(self, event: CameraGone, now_ns: int) -> list[Action]:
        was_away = self.away
        if event.back:
            self._camera_gone_ns = None
            return [Say("the camera is back: frames that were lost are taken again")] if was_away else []
        actions: list[Action] = [] if was_away else [RaiseFault(self._fault("F18", detail=event.detail))]
        actions += self._retake(self.intake.camera_gone(event.detail), now_ns)
        if not was_away:
            self._camera_gone_ns = now_ns
        return actions + (self._stop_stage(Decision.AWAIT_CAMERA, now_ns) if self.phase is Phase.RUN else [])

    # ---- the stage ----

    def _on_rest(self, event: SegmentDone | Moved | Stopped, now_ns: int) -> list[Action]:
        self.position_steps, self.silent = event.position_steps, False
        self._rest()
        if self.phase in STAGE_PHASES:
            self.deadline_ns = None
        if self.phase is Phase.LIMIT:
            self.checks.count_lost_steps(event.steps_lost if isinstance(event, Moved) else None)
            self._go(Decision.DRAIN, now_ns)
        return []

    def _on_held(self, event: Held, now_ns: int) -> list[Action]:
        self.position_steps = event.position_steps
        if event.reason not in _SILENCES:
            return []
        self.silent = True
        return [RaiseFault(self._fault(_SILENCES[event.reason], detail="it is waited for"))]

    def _on_alarm(self, event: Alarm, now_ns: int) -> list[Action]:
        # the controller stands already: nothing more will be heard of its segment
        self.position_steps, self.silent = event.position_steps, False
        self._distrust_stage()
        outcome = Outcome.INTERRUPTED if event.code in _CAN_BE_RESUMED else Outcome.ABORTED
        return self._give_up(outcome, event.detail, event.code, now_ns)

    def _rest(self) -> None:
        self._at_rest, self.window.running = True, False

    def _distrust_stage(self) -> None:
        """The controller failed: frames that it did not confirm are not taken, and it is not waited for."""
        self.retakes.taken -= set(self.intake.fail())
        self._rest()

    def _next_motion(self, now_ns: int) -> list[Action]:  # noqa: PLR0911
        """The stage rests and no frame is awaited: the next frames that are missing, then the checks, then the end."""
        actions: list[Action] = []
        if self.phase is Phase.OVERLAP:
            if self.checks.complaint:
                return self._refuse_overlap(now_ns)
            actions = [Say("the rig is where it was: the sweep goes on")]
        if self.finish.is_decided:
            return self._drain(now_ns)
        if self.phase is not Phase.REPEAT:
            if self.paused:
                return []
            run = self.retakes.next_run()
            if run is not None:
                return actions + self._begin_run(run, now_ns)
            wanted = self.settings.repeat_first and self.checks.first is not None
            if wanted and not self.away and not self._skip_checks:
                return actions + self._begin(Decision.REPEAT_FIRST, 0, 0, now_ns)
        if self._skip_checks or not self.settings.check_limit:
            return actions + self._drain(now_ns)
        self._move(Decision.CHECK_LIMIT, now_ns)
        return [*actions, Disarm(), CheckLimit()]

    def _begin_run(self, run: tuple[int, int], now_ns: int) -> list[Action]:
        if not self.away:
            return self._begin(Decision.BEGIN_RUN, *run, now_ns)
        if self.phase is not Phase.STOPPING:
            self._go(Decision.AWAIT_CAMERA, now_ns)
        return []

    def _begin(self, decision: Decision, first: int, last: int, now_ns: int) -> list[Action]:
        """Arm the camera and start a segment over the frames first..last; a check frame needs no credit."""
        self._move(decision, now_ns)
        self.intake.arm(now_ns)
        gated = decision is Decision.BEGIN_RUN
        granted = self.window.begin(first, last, gated=gated, ahead=self.intake.ahead)
        return [Arm(), BeginSegment(self.settings.segment(first, last), granted - first)]

    def _refuse_overlap(self, now_ns: int) -> list[Action]:
        complaint = self.checks.complaint
        fault = msgspec.structs.replace(
            self._fault("F01"),
            happened=f"the scan cannot go on: {complaint} (overlap.png beside the scan shows it)",
            to_do="put it back, or home the stage, and resume; or close the scan: 'sweepscope recover --seal'",
        )
        return [RaiseFault(fault), *self._end_early(Outcome.INTERRUPTED, f"overlap check: {complaint}", now_ns)]

    def _drain(self, now_ns: int) -> list[Action]:
        self._go(Decision.DRAIN, now_ns)
        return [Disarm()]

    def _grant(self, now_ns: int) -> list[Action]:
        """Raise the stage's credit as far as the window allows."""
        if self.phase is not Phase.RUN or self.paused:
            return []
        through = self.window.grant(self.intake.ahead)
        self._expect_stage(now_ns)
        return [] if through is None else [Grant(through - self.window.first)]

    def _hold(self) -> list[Action]:
        self.paused = True
        return [HoldStage()] if self.phase is Phase.RUN else []

    def _stop_stage(self, decision: Decision, now_ns: int) -> list[Action]:
        """Frames that are on their way are still taken; what follows is decided when the stage rests."""
        self._go(decision, now_ns)
        return [] if self._at_rest else [StopStage()]

    # ---- early ends ----

    def _give_up(self, outcome: Outcome, detail: str, code: str, now_ns: int) -> list[Action]:
        return [
            RaiseFault(self._fault(code, detail=detail)),
            *self._end_early(outcome, f"{code} {detail}", now_ns),
        ]

    def _end_early(self, outcome: Outcome, reason: str, now_ns: int) -> list[Action]:
        """What was taken is kept, the rest stays missing. The first outcome stands."""
        if self.finish.is_decided or self.phase in (Phase.DRAIN, Phase.SEAL):
            return []
        self.paused = self.window.short = False
        if self.phase in (Phase.REPEAT, Phase.LIMIT) and outcome is Outcome.STOPPED:
            self._skip_checks = True  # all frames are there: only the checks end early
        else:
            self.finish.decide(outcome, reason)
        return self._stop_stage(Decision.END_EARLY, now_ns)

    def _abandon(self, outcome: Outcome, reason: str, fault: FaultReport, now_ns: int) -> list[Action]:
        """No writer is there to seal the file."""
        self.finish.decide(outcome, reason)
        self._go(Decision.ABANDON, now_ns)
        return [StopStage(), Disarm(), RaiseFault(fault)]

    def _abandon_without_file(self, now_ns: int) -> list[Action]:
        fault = self._fault("F05", seconds=f"{self.settings.writer_start_ns / NS_PER_S:g}")
        return self._abandon(Outcome.FAILED, "no writer made the file ready", fault, now_ns)

    # ---- the operator ----

    def _on_pause(self, event: PauseRequested, now_ns: int) -> list[Action]:
        return self._hold() if self.can_pause and not self.paused else []

    def _on_resume(self, event: ResumeRequested, now_ns: int) -> list[Action]:
        if not self.paused:
            return []
        self.paused = False
        self.checks.accept_light()
        return [ResumeStage(), *self._grant(now_ns)] if self.phase is Phase.RUN else []

    def _on_stop(self, event: StopRequested, now_ns: int) -> list[Action]:
        return self._end_early(event.outcome, event.reason, now_ns)

    # ---- the writer ----

    def _on_writer_ready(self, event: WriterReady, now_ns: int) -> list[Action]:
        self.window.commit(event.committed)
        if not self.finish.has_writer and self.phase is Phase.SEAL:
            self.deadline_ns = now_ns + self.settings.seal_ns
        self.finish.has_writer = True
        if self.phase is not Phase.WAIT_WRITER:
            return [Say("the writer is back: frames that were on the way are sent again")] if event.came_back else []
        actions: list[Action] = []
        if not event.reserved:
            actions = [Say("this file system cannot reserve space: watch the disk")]
        if self.settings.resume is not None:
            # it has its ambient frame already
            self.retakes.taken |= self.window.committed.keys()
            return actions + self._light_lamp(now_ns)
        if not self.settings.dark_frames:
            return actions + self._light_lamp(now_ns)
        self._go(Decision.TAKE_AMBIENT, now_ns)
        return [*actions, SetLamp(on=False), Snap()]

    def _light_lamp(self, now_ns: int) -> list[Action]:
        self._go(Decision.LIGHT_LAMP, now_ns)
        return [SetLamp(on=True)]

    def _on_committed(self, event: Committed, now_ns: int) -> list[Action]:
        self.window.commit(event.frames)
        self._durable = event.durable_count
        return self._grant(now_ns)

    def _on_refused(self, event: Refused, now_ns: int) -> list[Action]:
        nack = event.nack
        refusal = understand(nack, has_file=self.phase is not Phase.WAIT_WRITER)
        if refusal.is_final:
            self.window.refuse(nack.role, nack.frame_index)
        if not refusal.code:
            return []
        fault = self._fault(refusal.code, detail=refusal.detail, **refusal.facts)
        if self.phase is Phase.WAIT_WRITER:
            return self._abandon(Outcome.FAILED, refusal.detail, fault, now_ns)
        if refusal.ends_sweep:
            return self._give_up(Outcome.FAILED, refusal.detail, refusal.code, now_ns)
        return [RaiseFault(fault)]

    def _seal_if_settled(self, now_ns: int) -> list[Action]:
        """Every frame that was taken must be committed before the end is sent."""
        if self.intake.confirmation or self.window.unacked:
            return []
        self._go(Decision.SEAL, now_ns)
        message = self.finish.end_message(self.settings.scan_uid, self.window, self.retakes, self.checks, self.counters)
        return [SendEnd(message)]

    def _on_sealed(self, event: Sealed, now_ns: int) -> list[Action]:
        """The writer answered to the end; where it could not seal, the scan can still be recovered."""
        if self.phase is not Phase.SEAL:
            return []
        end_ack = self.finish.end_ack = event.end_ack
        self._go(Decision.CLOSE, now_ns)
        # the writer has compared every frame with its checksum by now: what it reports counts
        self.window.revoke(end_ack.missing)
        if self.finish.outcome is Outcome.INTERRUPTED or end_ack.sealed:
            return []
        self.finish.decide(Outcome.INTERRUPTED, end_ack.reason)
        fault = self._fault("F07", detail=end_ack.reason)
        return [RaiseFault(msgspec.structs.replace(fault, to_do="mend the disk, then resume the scan"))]

    # ---- time ----

    def _on_tick(self, event: Tick, now_ns: int) -> list[Action]:
        actions = self._send(self.intake.confirmation.confirm(event.no_alarm_ns))
        if self._camera_is_missed(now_ns):
            actions += self._give_up(Outcome.INTERRUPTED, "it did not come back", "F18", now_ns)
        loss = self.intake.overdue(now_ns)
        if loss is not None:
            return actions + self._retake(loss, now_ns)
        if self.deadline_ns is None or now_ns < self.deadline_ns:
            return actions
        self.deadline_ns = None
        return actions + self._time_is_up(now_ns)

    def _time_is_up(self, now_ns: int) -> list[Action]:
        if self.phase is Phase.WAIT_WRITER or (self.phase is Phase.SEAL and not self.finish.has_writer):
            return self._abandon_without_file(now_ns)
        if self.phase is Phase.AMBIENT:
            return [Say("no ambient frame came: the camera does not answer"), *self._light_lamp(now_ns)]
        if self.phase is Phase.WARM_UP:
            return self._first_motion(now_ns)
        if self.phase in (Phase.DRAIN, Phase.SEAL):
            interrupted = self.finish.outcome is Outcome.INTERRUPTED
            reason = self.finish.reason if interrupted else "F03 the writer did not seal in time"
            return self._abandon(Outcome.INTERRUPTED, reason, self._fault("F03"), now_ns)
        self._distrust_stage()
        # it may still hear
        return [StopStage(), *self._give_up(Outcome.INTERRUPTED, "the stage does not answer", "F12", now_ns)]

    def _first_motion(self, now_ns: int) -> list[Action]:
        """A resumed sweep takes its last frame again and compares it; another one begins."""
        if self.settings.resume is None:
            return self._begin_run((0, self.count - 1), now_ns)
        last = self.settings.resume.last_frame
        return self._begin(Decision.COMPARE_OVERLAP, last, last, now_ns)

    def _camera_is_missed(self, now_ns: int) -> bool:
        """The sweep waits for its camera, and has waited long enough."""
        if self._camera_gone_ns is None or not self.can_pause:
            return False
        return now_ns - self._camera_gone_ns >= self.settings.camera_away_ns

    def _expect_stage(self, now_ns: int) -> None:
        """The stage must answer by the deadline only while it has something to do."""
        if self.phase in STAGE_PHASES:
            waiting = self.window.awaits_trigger() and not self.paused
            self.deadline_ns = now_ns + self.settings.motion_ns if waiting else None

    # ---- transitions ----

    def _move(self, decision: Decision, now_ns: int) -> None:
        self._at_rest = False
        self._go(decision, now_ns)

    def _go(self, decision: Decision, now_ns: int) -> None:
        """Change the phase by the table; what the new phase waits for has a deadline."""
        self.phase = next_phase(self.phase, decision)
        settings = self.settings
        if self.phase is Phase.STOPPING and self._at_rest:
            self.deadline_ns = None
            return
        seal_ns = settings.seal_ns if self.finish.has_writer else settings.writer_start_ns
        waits = {
            Phase.AMBIENT: settings.exposure_ns + settings.frame_timeout_ns,
            Phase.WARM_UP: round(settings.warm_up_ns * settings.time_scale),
            Phase.DRAIN: settings.seal_ns,
            Phase.SEAL: seal_ns,
        }
        self.deadline_ns = now_ns + waits.get(self.phase, settings.motion_ns)

    def _fault(self, code: str, **facts: object) -> FaultReport:
        """A fault in the words of the table, with what is safe of this sweep."""
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
