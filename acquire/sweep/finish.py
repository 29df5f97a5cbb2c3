"""How a sweep ends: its outcome, and the message that accounts for every frame of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from acquire.contract.frame_ranges import ranges_of
from acquire.contract.messaging.messages import End, EndAck
from acquire.contract.scan_data.checksums import scan_digest
from acquire.contract.states import Outcome

from .checks.self_checks import SelfChecks
from .credit_window import CreditWindow
from .retakes import Retakes


@dataclass
class Finish:
    """The verdict on a sweep. No sweep ends as complete of which a frame is missing."""

    outcome: Outcome = Outcome.RUNNING
    reason: str = ""
    has_writer: bool = False
    """A writer was ready at least once."""
    end_ack: EndAck | None = None
    """The writer's answer to the end."""

    @property
    def is_decided(self) -> bool:
        """The outcome is known before the last frame: nothing more is taken."""
        return self.outcome is not Outcome.RUNNING

    @property
    def is_sealed(self) -> bool:
        """The writer has closed the file for good."""
        return self.outcome is not Outcome.INTERRUPTED and self.end_ack is not None and self.end_ack.sealed

    def decide(self, outcome: Outcome, reason: str) -> None:
        """Set the outcome."""
        self.outcome, self.reason = outcome, reason

    def end_message(
        self, scan_uid: str, window: CreditWindow, retakes: Retakes, checks: SelfChecks, counters: Mapping[str, int]
    ) -> End:
        """The account of the sweep; frames that are not committed are missing.

        An interrupted sweep is not sealed, so that it can be resumed; the file learns why it was interrupted.
        """
        count = retakes.count
        if not self.is_decided:
            self.outcome = Outcome.COMPLETE if window.prefix == count else Outcome.FAILED
        crc32 = np.zeros(count, np.uint32)
        for frame_index, value in window.committed.items():
            crc32[frame_index] = value
        return End(
            scan_uid=scan_uid,
            outcome=self.outcome,
            reason="; ".join(filter(None, (self.reason, checks.light_note()))),
            expected=count,
            sent=len(retakes.taken),
            missing=ranges_of([k for k in range(count) if k not in window.committed]),
            retaken=ranges_of([k for k in retakes.attempts if k in window.committed]),
            digest=scan_digest(crc32),
            counters=dict(counters),
            checks=dict(checks.measured),
        )
