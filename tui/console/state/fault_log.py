"""Every fault of this session with its time of day, acknowledged or not, also those that the daemon has dropped."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from datetime import datetime

from acquire.contract.faults import headline
from acquire.contract.messaging.messages import FaultReport
from acquire.contract.process.clocks import mono_ns
from acquire.contract.units import NS_PER_S

MAX_FAULTS = 500


@dataclass(frozen=True)
class LoggedFault:
    """A fault and when it happened."""

    report: FaultReport
    at: str
    """Local date and time of day."""
    current: bool = True
    """The daemon still reports it; False once it has dropped it or was restarted."""

    @property
    def key(self) -> tuple[str, int]:
        """Code and time: what identifies a fault."""
        return self.report.code, self.report.at_mono_ns

    def as_text(self) -> str:
        """All of it, for a message to another person."""
        seen = "acknowledged" if self.report.acknowledged else "not acknowledged"
        return (
            f"{self.at}  {headline(self.report)}\n  safe:  {self.report.safe}\n  to do: {self.report.to_do}\n  {seen}"
        )


class FaultLog:
    """Takes the faults of each status."""

    def __init__(self, wall_time: Callable[[int], str] | None = None) -> None:
        """``wall_time``: local date and time of a CLOCK_MONOTONIC in ns."""
        self._wall_time = wall_time or _wall_time
        self._faults: dict[tuple[str, int], LoggedFault] = {}

    def take(self, reports: Iterable[FaultReport]) -> None:
        """The faults that the daemon reports now."""
        self._faults = {key: replace(fault, current=False) for key, fault in self._faults.items()}
        for report in reports:
            key = (report.code, report.at_mono_ns)
            known = self._faults.get(key)
            self._faults[key] = LoggedFault(report, known.at if known else self._wall_time(report.at_mono_ns))
        while len(self._faults) > MAX_FAULTS:
            self._faults.pop(next(iter(self._faults)))

    @property
    def faults(self) -> list[LoggedFault]:
        """The newest first."""
        return sorted(self._faults.values(), key=lambda fault: fault.report.at_mono_ns, reverse=True)


def _wall_time(at_mono_ns: int) -> str:
    ago_s = (mono_ns() - at_mono_ns) / NS_PER_S
    return datetime.fromtimestamp(time.time() - ago_s).astimezone().strftime("%Y-%m-%d %H:%M:%S")
