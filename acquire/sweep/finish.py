"""How a sweep ends: every frame that was taken is committed, the end is said, the file is sealed. Nothing moves.

It promises that no sweep ends as complete of which a frame is missing, and that it ends even where no writer answers.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec

from acquire.contract.messaging.messages import FaultReport
from acquire.contract.states import Outcome
from acquire.contract.units import NS_PER_S

from .actions import Action, Disarm, Finish, RaiseFault, StopStage
from .events import Sealed
from .frame_intake import Intake
from .frame_messages import end_of_sweep
from .phases import Deadline, Phase
from .progress import Shooting
from .self_checks import Checks


@dataclass
class Closing:
    """Keeps the verdict, from wherever it came, and carries it to the file."""

    shooting: Shooting
    intake: Intake
    checks: Checks
    outcome: Outcome = Outcome.RUNNING
    reason: str = ""
    phase: Phase | None = None
    """None until the stage has come to rest for good."""
    result: Sealed | None = None
    deadline: Deadline = field(default_factory=Deadline)
    _has_writer: bool = False
    """A writer was ready at least once."""

    @property
    def is_decided(self) -> bool:
        """True when nothing can change the outcome any more but the writer."""
        return self.outcome is not Outcome.RUNNING or self.phase is not None

    @property
    def is_sealed(self) -> bool:
        """True when the writer has closed the file for good."""
        return self.outcome is not Outcome.INTERRUPTED and self.result is not None and self.result.end_ack.sealed

    def decide(self, outcome: Outcome, reason: str) -> None:
        """The sweep ends early; what has been taken by then is kept."""
        self.outcome, self.reason = outcome, reason

    def writer_ready(self, now_ns: int) -> None:
        """A writer that comes late is given its time to seal."""
        if not self._has_writer and self.phase is Phase.SEAL:
            self.deadline.at_ns = now_ns + self.shooting.settings.seal_ns
        self._has_writer = True

    def drain(self, now_ns: int) -> list[Action]:
        """Every frame that was taken must be committed before the end is said."""
        self.phase = Phase.DRAIN
        self.deadline.at_ns = now_ns + self.shooting.settings.seal_ns
        return []

    def look_around(self, now_ns: int) -> list[Action]:
        """Say the end as soon as nothing is on its way any more."""
        settled = self.intake.nothing_waits and self.shooting.window.is_settled()
        return self._finish(now_ns) if self.phase is Phase.DRAIN and settled else []

    def _finish(self, now_ns: int) -> list[Action]:
        # an interrupted sweep is not sealed, so that it can go on another time; the file learns why it was
        settings, window = self.shooting.settings, self.shooting.window
        self.phase = Phase.SEAL
        # without a writer there is nothing to seal: one that is slow to come is waited for as at the start
        self.deadline.at_ns = now_ns + (settings.seal_ns if self._has_writer else settings.writer_start_ns)
        if self.outcome is Outcome.RUNNING:
            self.outcome = Outcome.COMPLETE if window.prefix == settings.plan.count else Outcome.FAILED
        end = end_of_sweep(
            self.outcome,
            "; ".join(filter(None, (self.reason, self.checks.light_note()))),
            settings=settings,
            sent=len(self.shooting.paired),
            window=window,
            retaken=[k for k in self.shooting.attempts if k in window.committed],
            counters=self.accounts(),
            checks=self.checks.measured,
        )
        return [Finish(end)]

    def accounts(self) -> dict[str, int]:
        """Every counter of the sweep, by name."""
        more = {"conflicts": self.shooting.window.conflicts, "holds_no_credit": self.shooting.holds}
        return self.intake.counters | more

    def sealed(self, event: Sealed) -> list[Action]:
        """The writer answered to the end; where it could not seal, the scan can still be recovered."""
        if self.phase is not Phase.SEAL:
            return []
        self.phase, self.result = Phase.DONE, event
        # the writer has compared every frame with its checksum by now: what it says counts
        self.shooting.window.revoke(event.end_ack.missing)
        if self.outcome is Outcome.INTERRUPTED or event.end_ack.sealed:
            return []
        self.decide(Outcome.INTERRUPTED, event.end_ack.reason)
        fault = self.shooting.fault("F07", detail=event.end_ack.reason)
        return [RaiseFault(msgspec.structs.replace(fault, to_do="mend the disk, then resume the scan"))]

    def time_is_up(self) -> list[Action]:
        """The writer did not answer in time."""
        if self.phase is Phase.SEAL and not self._has_writer:
            return self.abandon_without_writer()
        reason = self.reason if self.outcome is Outcome.INTERRUPTED else "F03 the writer did not seal in time"
        return self.abandon(Outcome.INTERRUPTED, reason, self.shooting.fault("F03"))

    def abandon_without_writer(self) -> list[Action]:
        """No file was ever made."""
        seconds = f"{self.shooting.settings.writer_start_ns / NS_PER_S:g}"
        fault = self.shooting.fault("F05", seconds=seconds)
        return self.abandon(Outcome.FAILED, "no writer made the file ready", fault)

    def abandon(self, outcome: Outcome, reason: str, fault: FaultReport) -> list[Action]:
        """There is nobody to say an end to."""
        self.decide(outcome, reason)
        self.phase = Phase.DONE
        return [StopStage(), Disarm(), RaiseFault(fault)]
