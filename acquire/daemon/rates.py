"""Growth of a count per second, over the last few seconds."""

from __future__ import annotations

from collections import deque

from acquire.contract.units import NS_PER_S


class Rate:
    """Counts per second over a sliding window, from monotonic time."""

    def __init__(self, window_s: float = 5.0) -> None:
        self._window_ns = round(window_s * NS_PER_S)
        self._points: deque[tuple[int, int]] = deque()

    def update(self, count: int, now_ns: int) -> float:
        """Take the count as it is now; returns counts per second, 0 until two points are apart."""
        if self._points and count < self._points[-1][1]:
            self._points.clear()
        if not self._points or count != self._points[-1][1] or now_ns - self._points[-1][0] > NS_PER_S // 4:
            self._points.append((now_ns, count))
        while len(self._points) > 2 and now_ns - self._points[0][0] > self._window_ns:
            self._points.popleft()
        then_ns, then = self._points[0]
        return (count - then) * NS_PER_S / (now_ns - then_ns) if now_ns > then_ns else 0.0
