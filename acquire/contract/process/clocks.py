"""Monotonic time for control, injected so that tests need no waiting; UTC as metadata only."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from typing import Protocol


def mono_ns() -> int:
    """CLOCK_MONOTONIC in ns: the clock of every time that is named ``..._mono_ns`` or ``at_ns``."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC)


class Clock(Protocol):
    """Source of the present time; tests replace it."""

    def now_ns(self) -> int:
        """CLOCK_MONOTONIC in ns."""
        ...


class MonotonicClock:
    """The machine's CLOCK_MONOTONIC."""

    def now_ns(self) -> int:
        """CLOCK_MONOTONIC in ns."""
        return mono_ns()


def utc_now_iso() -> str:
    """UTC now as ISO 8601 with Z, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def utc_stamp() -> str:
    """UTC now as in the names of scan folders."""
    return datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")


def epoch_utc_ns() -> int:
    """UTC minus CLOCK_MONOTONIC in ns: what to add to a monotonic time to get UTC."""
    return time.time_ns() - mono_ns()
