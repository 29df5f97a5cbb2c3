"""Monotonic time for control, injected so that tests need no waiting; UTC only as metadata."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from typing import Protocol


class Clock(Protocol):
    """What a component needs to know of time."""

    def now_ns(self) -> int:
        """CLOCK_MONOTONIC in ns."""
        ...


class MonotonicClock:
    """The machine's CLOCK_MONOTONIC."""

    def now_ns(self) -> int:
        """CLOCK_MONOTONIC in ns."""
        return time.clock_gettime_ns(time.CLOCK_MONOTONIC)


def utc_now_iso() -> str:
    """UTC now as ISO 8601 with Z, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def utc_stamp() -> str:
    """UTC now as it stands in a scan folder's name."""
    return datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")


def epoch_utc_ns() -> int:
    """UTC minus CLOCK_MONOTONIC in ns: what to add to a monotonic time to get UTC."""
    return time.time_ns() - time.clock_gettime_ns(time.CLOCK_MONOTONIC)
