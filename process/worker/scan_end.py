"""Owns what is known about how a scan ended, and which frames will therefore never come."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from acquire.contract.messaging.messages import End, FrameRange
from acquire.contract.scan_data.report_file import SweepChecks
from acquire.contract.states import SEALED_OUTCOMES, Outcome


@dataclass(frozen=True)
class Ending:
    """The end of a scan as the rig told it; ``running`` before it did."""

    outcome: str = Outcome.RUNNING.value
    missing: tuple[FrameRange, ...] = ()
    """Frame ranges [first, last] that were never taken, both ends included."""
    checks: SweepChecks = field(default_factory=SweepChecks)

    @classmethod
    def of(cls, end: End) -> Ending:
        """From the end message."""
        return cls(end.outcome.value, tuple(end.missing), SweepChecks.of(end.checks))

    @property
    def known(self) -> bool:
        """The scan is over, for good."""
        return self.outcome in SEALED_OUTCOMES

    def never(self, count: int, file_outcome: str) -> NDArray[np.bool_] | None:
        """Frames that will not come any more, [count]: those named missing, all of them once the file is sealed."""
        if not self.known:
            return None
        never = np.full(count, file_outcome in SEALED_OUTCOMES)
        for first, last in self.missing:
            never[first : last + 1] = True
        return never
