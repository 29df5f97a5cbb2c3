"""Decides when the next picture may go to the terminal and how fine it is, from what the link was seen to carry; pure.

One picture is under way at a time: the next waits until the terminal has answered for the last one, so a slow link
never holds more than one. What one picture takes decides its detail, what the link carries decides its rate.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from tui.raster import STEPS_DOWN, Detail

TOO_LONG_S = 0.15
"""A picture that holds the link longer is drawn coarser: a key's echo waits behind at most this."""
SHORT_S = 0.03
CALM_PICTURES = 8
"""So many quick pictures in a row, and the next finer detail is tried."""
SHARE = 0.5
"""Pictures get at most this share of the link's time."""
STALLED_S = 1.0
"""A terminal that has not answered for so long is stalled: nothing more is painted until it does."""
DEAF_S = 3.0
"""A terminal that has not answered its first question for so long never answers any."""
SMOOTH = 0.3


@dataclass
class Governor:
    """Fed with times and bytes; all times are monotonic seconds."""

    wanted_hz: float = 5.0
    """Pictures per second where nothing stands against it."""
    base_s: float = field(default=float("inf"))
    """Shortest round trip that was ever seen: the link's own delay, which no lower rate mends."""
    rate_bytes_per_s: float | None = None
    """What the link carries; None while nothing large enough was sent."""
    finest: int = 0
    """Index of the finest detail that may be tried."""
    _step: int = 0
    _calm: int = 0
    _next_s: float = float("-inf")
    _asked_s: float | None = None
    _asked_bytes: int = 0
    _sent_s: list[float] = field(default_factory=list)
    deaf: bool = False
    """True if the terminal answers no questions: then only our own queue is known."""
    answers: int = 0

    @property
    def detail(self) -> Detail:
        """How fine the next picture is drawn."""
        return STEPS_DOWN[self._step]

    @property
    def asking(self) -> bool:
        """True while an answer is awaited."""
        return self._asked_s is not None

    def may_send(self, now_s: float, backlog_bytes: int) -> bool:
        """True if a picture may be painted now."""
        self._give_up(now_s)
        return self._asked_s is None and now_s >= self._next_s and not backlog_bytes

    def asked(self, now_s: float, nbytes: int) -> None:
        """A picture of ``nbytes`` and a question behind it were handed to the terminal."""
        self._sent_s = [at_s for at_s in self._sent_s if now_s - at_s < 2.0] + [now_s]
        self._next_s = now_s + 1.0 / self.wanted_hz
        if not self.deaf:
            self._asked_s, self._asked_bytes = now_s, nbytes

    def answered(self, now_s: float) -> None:
        """The terminal has shown everything up to the question."""
        if self._asked_s is None:
            return
        took_s, self._asked_s = now_s - self._asked_s, None
        self.answers += 1
        self.base_s = min(self.base_s, took_s)
        held_s = took_s - self.base_s
        if held_s > SHORT_S / 2 and self._asked_bytes > 1000:
            rate = self._asked_bytes / held_s
            known = self.rate_bytes_per_s
            self.rate_bytes_per_s = rate if known is None else known + SMOOTH * (rate - known)
        self._next_s = max(self._next_s, now_s + held_s * (1.0 / SHARE - 1.0))
        self._adapt(held_s)

    def _adapt(self, held_s: float) -> None:
        if held_s > TOO_LONG_S:
            self._step = min(len(STEPS_DOWN) - 1, self._step + 1)
            self._calm = 0
        elif held_s < SHORT_S:
            self._calm += 1
            if self._calm >= CALM_PICTURES and self._step > self.finest:
                self._step, self._calm = self._step - 1, 0
        else:
            self._calm = 0

    def _give_up(self, now_s: float) -> None:
        if self._asked_s is not None and not self.answers and now_s - self._asked_s > DEAF_S:
            self.deaf, self._asked_s = True, None

    def stalled(self, now_s: float, blocked_s: float) -> bool:
        """True while painting only adds to a queue: the last answer, or our own writing (``blocked_s``), is overdue."""
        self._give_up(now_s)
        waiting_s = now_s - self._asked_s if self._asked_s is not None and self.answers else 0.0
        return max(waiting_s, blocked_s) > STALLED_S

    def picture_hz(self, now_s: float) -> float:
        """Pictures per second over the last two seconds."""
        return sum(now_s - at_s < 2.0 for at_s in self._sent_s) / 2.0

    def words(self, now_s: float) -> str:
        """``link 180 kB/s, picture 3 Hz``; what is not known is left out."""
        hz = f"picture {self.picture_hz(now_s):.3g} Hz"
        if self.rate_bytes_per_s is not None:
            hz = f"link {self.rate_bytes_per_s / 1000:.0f} kB/s, {hz}"
        return hz if not self._step else f"{hz}, coarser"
