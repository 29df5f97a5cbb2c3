"""A sparkline: the newest values of a rate as one row of bars; pure.

Scaled from zero, which Textual's Sparkline does not: a steady rate with a little noise is a flat line.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

BARS = "▁▂▃▄▅▆▇█"


class History:
    """One value per second, the newest ``length`` of them."""

    def __init__(self, length: int = 240) -> None:
        self.values: deque[float] = deque(maxlen=length)
        self._second: int | None = None

    def add(self, value: float, now_s: float) -> None:
        """Add the value of this second; a later one in the same second replaces it."""
        if self._second == int(now_s) and self.values:
            self.values.pop()
        self._second = int(now_s)
        self.values.append(value)

    def clear(self) -> None:
        """Forget all values."""
        self.values.clear()


def sparkline(values: Sequence[float], width: int) -> str:
    """The newest ``width`` values, scaled from 0 to the largest of them."""
    shown = list(values)[-width:] if width > 0 else []
    top = max(shown, default=0.0) or 1.0
    return "".join(BARS[round(max(0.0, value) / top * (len(BARS) - 1))] for value in shown)
