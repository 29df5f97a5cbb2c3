"""Which frames were taken, which come next, and how far the stage may trigger. Pure: the sweep's book of shots."""

from __future__ import annotations

from dataclasses import dataclass, field

from acquire.contract.faults import report
from acquire.contract.messaging.messages import FaultReport
from acquire.contract.units import steps_to_um
from acquire.stages.protocol import Segment, Triggered
from acquire.sweep.settings import SweepSettings

from .actions import Action, Arm, BeginSegment, Grant
from .credit_window import Window
from .pairing import Ledger


@dataclass
class Shooting:
    """Segments, credit and retakes of one sweep."""

    settings: SweepSettings
    window: Window
    ledger: Ledger = field(default_factory=Ledger)
    paired: set[int] = field(default_factory=set)
    """Frames that arrived and are proven to belong to their trigger."""
    attempts: dict[int, int] = field(default_factory=dict)
    """Attempts that were lost, by frame index."""
    triggered_through: int = -1
    short_of_credit: bool = False
    holds: int = 0
    """How often the stage had to wait for the writer."""
    segment_done: bool = True
    _first: int = 0
    _last: int = -1
    _granted: int = -1
    _gated: bool = True

    def next_run(self) -> tuple[int, int] | None:
        """First and last of the first run of frames that nobody has yet; None when all are taken."""
        count, paired = self.settings.plan.count, self.paired
        first = next((k for k in range(count) if k not in paired), None)
        if first is None:
            return None
        last = first
        while last + 1 < count and last + 1 not in paired:
            last += 1
        return first, last

    def begin(self, first: int, last: int, now_ns: int, *, gated: bool = True) -> list[Action]:
        """Arm and start a segment over the frames first..last; a check frame (not gated) needs no credit."""
        plan = self.settings.plan
        segment = Segment(
            first_steps=plan.position_steps(first),
            pitch_steps=plan.pitch_steps,
            count=last - first + 1,
            mode=plan.mode,
            settle_ms=plan.settle_ms,
            dwell_ms=plan.exposure_ms,
            period_ms=self.settings.period_ms,
            run_up_steps=self.settings.run_up_steps,
        )
        self.ledger.arm(now_ns, self.settings.spacing)
        self._first, self._last, self._gated = first, last, gated
        self.triggered_through = first - 1
        self.segment_done = False
        self._granted = self._credit() if gated else last
        return [Arm(), BeginSegment(segment, self._granted - first)]

    def triggered(self, event: Triggered, now_ns: int) -> str:
        """Book a trigger; returns what is wrong with it in words, empty when all is well."""
        plan, frame_index = self.settings.plan, self._first + event.shot_index
        planned = plan.position_steps(frame_index)
        if event.position_steps != planned or not self._first <= frame_index <= self._granted:
            return f"frame {frame_index} was triggered at {event.position_steps} microsteps, planned {planned}"
        self.triggered_through = max(self.triggered_through, frame_index)
        um = steps_to_um(event.position_steps, plan.um_per_microstep)
        self.ledger.triggered(
            frame_index=frame_index,
            attempt=self.attempts.get(frame_index, 0),
            trigger_id=event.trigger_id,
            position_steps=event.position_steps,
            position_um=um if event.position_um is None else event.position_um,
            trigger_cycles=event.trigger_cycles,
            at_mono_ns=event.at_mono_ns or now_ns,
            deadline_ns=now_ns + self.settings.exposure_ns + self.settings.frame_timeout_ns,
            fired_ns=event.fired_ns,
        )
        return ""

    def awaits_trigger(self) -> bool:
        """True while a trigger that has credit, or the segment's end, is still to come from the stage."""
        if self.segment_done:
            return False
        return self.triggered_through < self._granted or self.triggered_through == self._last

    def grant(self) -> list[Action]:
        """Raise the credit where there is some; after a hold for want of it, only when half the window is free."""
        if self.segment_done or not self._gated:
            return []
        free = self.window.free(self.triggered_through)
        if free <= 0 and self.triggered_through < self._last and not self.short_of_credit:
            self.short_of_credit = True
            self.holds += 1
        if self.short_of_credit:
            if free < max(1, self.window.slots // 2):
                return []
            self.short_of_credit = False
        credit = self._credit()
        if credit <= self._granted:
            return []
        self._granted = credit
        return [Grant(credit - self._first)]

    def fault(self, code: str, **facts: object) -> FaultReport:
        """A fault in the words of the table, with what is safe of this sweep."""
        return report(code, 0, committed=len(self.window.committed), expected=self.settings.plan.count, **facts)

    def _credit(self) -> int:
        """The last frame that may be triggered: a slot is free, and the frame before has arrived.

        The latter in step mode, and on the fly until time can tell frames apart (for a camera without a clock: always).
        """
        through = min(self.window.may_trigger_through(), self._last)
        if self.settings.plan.mode == "step" or not self.ledger.can_tell:
            through = min(through, self.triggered_through + (0 if self.ledger.pending else 1))
        return through
