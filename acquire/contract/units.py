"""Units: the conversions that more than one process needs, each defined once."""

from __future__ import annotations

import math

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
UM_PER_MM = 1000.0


def ns_from_ms(duration_ms: float) -> int:
    """Whole nanoseconds in ``duration_ms`` milliseconds."""
    return round(duration_ms * NS_PER_MS)


def steps_to_um(position_steps: int, um_per_microstep: float) -> float:
    """Stage position in um from its position in microsteps."""
    return position_steps * um_per_microstep


def nice_length(length: float, *, above: bool = False) -> float:
    """1, 2 or 5 times a power of ten: the largest that is not above ``length``, or the smallest not below it."""
    length = max(length, 1e-12)
    power = 10.0 ** math.floor(math.log10(length))
    nice = [step * power for step in (1, 2, 5, 10)]
    # the tolerances keep a length that differs from a nice one by rounding only
    if above:
        return next(step for step in nice if step >= length * 0.999)
    return max(step for step in nice if step <= length * 1.0001)


def format_duration(duration_s: float | None) -> str:
    """``h:mm:ss`` of a duration in seconds, rounded up to the second; ``-:--:--`` where it is not known."""
    if duration_s is None or not math.isfinite(duration_s):
        return "-:--:--"
    whole_s = max(0, -int(-duration_s // 1))
    return f"{whole_s // 3600}:{whole_s // 60 % 60:02d}:{whole_s % 60:02d}"


def format_bytes(size_bytes: float) -> str:
    """A size in bytes with a unit, in powers of 1000."""
    for unit in ("B", "kB", "MB", "GB"):
        if abs(size_bytes) < 1000:
            return f"{size_bytes:.0f} {unit}" if unit == "B" else f"{size_bytes:.1f} {unit}"
        size_bytes /= 1000
    return f"{size_bytes:.1f} TB"
