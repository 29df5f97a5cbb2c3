"""A sparkline: the last values of something as one row of signs; pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

_BARS = "▁▂▃▄▅▆▇█"
_ASCII_BARS = "_.-~=+*#"


class History:
    """One value for each second, the newest ``length`` of them."""

    def __init__(self, length: int = 240) -> None:
        self.values: deque[float] = deque(maxlen=length)
        self._second: int | None = None

    def add(self, value: float, now_s: float) -> None:
        """Take the value of this second; a later one in the same second replaces it."""
        if self._second == int(now_s) and self.values:
            self.values[-1] = value
        else:
            self._second = int(now_s)
            self.values.append(value)

    def clear(self) -> None:
        """Forget all."""
        self.values.clear()


def sparkline(values: Sequence[float], width: int, *, ascii_only: bool = False) -> str:
    """The newest ``width`` values, scaled from 0 to the largest of them."""
    bars = _ASCII_BARS if ascii_only else _BARS
    shown = list(values)[-width:] if width > 0 else []
    top = max(shown, default=0.0)
    if top <= 0:
        return bars[0] * len(shown)
    return "".join(bars[min(len(bars) - 1, int(max(0.0, value) / top * (len(bars) - 1) + 0.5))] for value in shown)
