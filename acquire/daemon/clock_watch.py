"""Detects that this process was frozen or that the wall clock jumped, for the log; nothing is controlled by either."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from acquire.contract.units import NS_PER_S

LEAST_JUMP_NS: Final = NS_PER_S
"""Shorter gaps and jumps are normal: a busy machine, a clock that NTP adjusts."""


@dataclass
class ClockWatch:
    """Updated with both clocks in each turn of the daemon's loop."""

    _mono_ns: int | None = None
    _epoch_ns: int = 0

    def update(self, mono_ns: int, epoch_utc_ns: int) -> list[tuple[Literal["F02", "F22"], float]]:
        """Take CLOCK_MONOTONIC (ns) and UTC minus it (ns); returns faults with their seconds (F22 signed)."""
        found: list[tuple[Literal["F02", "F22"], float]] = []
        if self._mono_ns is not None:
            gap, jump = mono_ns - self._mono_ns, epoch_utc_ns - self._epoch_ns
            if gap > LEAST_JUMP_NS:
                found.append(("F02", gap / NS_PER_S))
            if abs(jump) > LEAST_JUMP_NS:
                found.append(("F22", jump / NS_PER_S))
        self._mono_ns, self._epoch_ns = mono_ns, epoch_utc_ns
        return found
