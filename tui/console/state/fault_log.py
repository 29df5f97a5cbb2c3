"""Every fault of this session, acknowledged or not, with its time of day: what was seen once is never hidden."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime

from acquire.contract.messaging.messages import FaultReport
from acquire.contract.process.clocks import mono_ns
from acquire.contract.units import NS_PER_S

MOST = 500


@dataclass(frozen=True)
class BookedFault:
    """A fault and when it happened."""

    report: FaultReport
    at: str
    """Local date and time of day."""
    still_told: bool
    """The daemon still tells of it; False once it has been started again or has let it go."""

    @property
    def key(self) -> tuple[str, int]:
        """Tells it from others."""
        return self.report.code, self.report.at_mono_ns

    def as_text(self) -> str:
        """The whole of it, for a message to somebody else."""
        seen = "acknowledged" if self.report.acknowledged else "not acknowledged"
        return (
            f"{self.at}  {self.report.code}  {self.report.happened}\n  safe:  {self.report.safe}\n"
            f"  to do: {self.report.to_do}\n  {seen}"
        )


class FaultBook:
    """Takes each status' faults; the newest first."""

    def __init__(self, wall_time: Callable[[int], str] | None = None) -> None:
        """``wall_time``: local time of day of a CLOCK_MONOTONIC in ns."""
        self._wall_time = wall_time or _wall_time
        self._faults: dict[tuple[str, int], BookedFault] = {}

    def take(self, reports: Iterable[FaultReport]) -> None:
        """What the daemon tells now."""
        told = {(report.code, report.at_mono_ns): report for report in reports}
        for key, fault in self._faults.items():
            if key not in told and fault.still_told:
                self._faults[key] = BookedFault(fault.report, fault.at, still_told=False)
        for key, report in told.items():
            known = self._faults.get(key)
            at = known.at if known else self._wall_time(report.at_mono_ns)
            self._faults[key] = BookedFault(report, at, still_told=True)
        while len(self._faults) > MOST:
            self._faults.pop(next(iter(self._faults)))

    @property
    def faults(self) -> list[BookedFault]:
        """The newest first."""
        return sorted(self._faults.values(), key=lambda fault: fault.report.at_mono_ns, reverse=True)


def _wall_time(at_mono_ns: int) -> str:
    ago_s = (mono_ns() - at_mono_ns) / NS_PER_S
    return datetime.fromtimestamp(time.time() - ago_s).astimezone().strftime("%Y-%m-%d %H:%M:%S")
