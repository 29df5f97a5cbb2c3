"""The state of one sweep: phase, deadline and frames; and what the daemon shows of it. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from acquire.contract.faults import report
from acquire.contract.messaging.messages import EndAck, FaultReport
from acquire.contract.states import HoldReason, Outcome, State
from acquire.sweep.checks.self_checks import SelfChecks

from .actions import Action, SetLamp, StopStage
from .credit_window import CreditWindow
from .frame_intake import FrameIntake
from .phases import BEFORE_MOTION, SHOOTING, Decision, Phase, next_phase
from .retakes import Retakes
from .settings import SweepSettings


@dataclass
class SweepState:
    """Nothing of it is shared with anything outside the sweep."""

    settings: SweepSettings
    slots: int
    """Frames that may be uncommitted at a time."""
    phase: Phase = Phase.WAIT_WRITER
    deadline_ns: int | None = None
    """Deadline of the awaited answer; None while no answer is awaited."""
    outcome: Outcome = Outcome.RUNNING
    """How the sweep ends; running until that is decided."""
    reason: str = ""
    has_writer: bool = False
    """A writer was ready at least once."""
    end_ack: EndAck | None = None
    """The writer's answer to the end."""
    position_steps: int = 0
    """The last known position of the stage, in microsteps."""
    at_rest: bool = True
    """The stage rests, or its answer is no longer awaited."""
    paused: bool = False
    """True from a pause, or a change of the light, until the operator resumes the sweep."""
    lost_contact: bool = False
    """The controller holds because its link to the host is silent; it continues by itself."""
    camera_gone_ns: int | None = None
    """Time at which the camera went away; None while it is there. The sweep continues by itself when it is back."""
    skip_checks: bool = False
    """All frames are taken, and the operator wants no more checks."""
    durable_count: int = 0

    def __post_init__(self) -> None:
        self.count = self.settings.plan.count
        self.window = CreditWindow(self.slots)
        self.retakes = Retakes(self.count, self.settings.max_attempts)
        self.intake = FrameIntake(self.settings, self.window)
        self.checks = SelfChecks(self.settings)

    # ---- transitions ----

    def go(self, decision: Decision, now_ns: int, wait_ns: int | None) -> None:
        """Change the phase by the table; ``wait_ns``: longest wait for an answer, None: no answer is awaited.

        Raises:
            IllegalTransitionError: the table has no such transition: a bug.
        """
        self.phase = next_phase(self.phase, decision)
        self.deadline_ns = None if wait_ns is None else now_ns + wait_ns

    def move(self, decision: Decision, now_ns: int) -> None:
        """Change the phase to one in which the stage moves."""
        self.at_rest = False
        self.go(decision, now_ns, self.settings.motion_ns)

    def stop_stage(self, decision: Decision, now_ns: int) -> list[Action]:
        """Stop the stage; frames on their way are still taken, and the next decision is made when the stage rests."""
        self.go(decision, now_ns, None if self.at_rest else self.settings.motion_ns)
        return [] if self.at_rest else [StopStage()]

    def light_lamp(self, now_ns: int) -> list[Action]:
        """Light the lamp and wait until it is warm."""
        self.go(Decision.LIGHT_LAMP, now_ns, round(self.settings.warm_up_ns * self.settings.time_scale))
        return [SetLamp(on=True)]

    def rest(self) -> None:
        """The stage rests, or its answer is no longer awaited."""
        self.at_rest, self.window.running = True, False

    def distrust_stage(self) -> None:
        """The controller failed: frames that it did not confirm are not taken, its answers no longer awaited."""
        self.retakes.taken -= set(self.intake.fail())
        self.rest()

    def fault(self, code: str, **facts: object) -> FaultReport:
        """A fault in the words of the table, with what is safe of this sweep."""
        return report(code, 0, committed=len(self.window.committed), expected=self.count, **facts)

    # ---- what the daemon shows ----

    @property
    def is_decided(self) -> bool:
        """The outcome is known: no more frames are taken."""
        return self.outcome is not Outcome.RUNNING

    @property
    def away(self) -> bool:
        """True while the camera is gone."""
        return self.camera_gone_ns is not None

    def camera_is_missed(self, now_ns: int) -> bool:
        """The sweep has waited for its camera long enough."""
        gone_ns = self.camera_gone_ns
        return gone_ns is not None and self.can_pause and now_ns - gone_ns >= self.settings.camera_away_ns

    @property
    def hold_reason(self) -> HoldReason | None:
        """Why the stage holds; None when it does not."""
        reasons = {
            HoldReason.PAUSED: self.paused,
            HoldReason.LINK_LOST: self.lost_contact,
            HoldReason.CAMERA_AWAY: self.away,
            HoldReason.NO_CREDIT: self.window.short,
        }
        return next((reason for reason, holds in reasons.items() if holds and self.phase in SHOOTING), None)

    @property
    def state(self) -> State:
        """The rig's state that belongs to the phase."""
        if self.phase in SHOOTING:
            return State.HOLDING if self.hold_reason else State.SWEEPING
        return State.ARMED if self.phase in BEFORE_MOTION else State.FINISHING

    @property
    def can_pause(self) -> bool:
        """True while frames are being taken."""
        return self.phase in (Phase.RUN, Phase.STOPPING) and not self.is_decided

    @property
    def durable(self) -> int:
        """Frames that survive a power cut."""
        sealed = self.outcome is not Outcome.INTERRUPTED and self.end_ack is not None and self.end_ack.sealed
        return len(self.window.committed) if sealed else self.durable_count

    @property
    def retaken(self) -> list[int]:
        """Frames that were lost at least once and are committed."""
        return [k for k in self.retakes.attempts if k in self.window.committed]

    @property
    def counters(self) -> dict[str, int]:
        """Every counter of the sweep, by name."""
        credit = {"conflicts": self.window.conflicts, "holds_no_credit": self.window.holds}
        return self.intake.counters | credit | {"lost": sum(self.retakes.attempts.values())}
