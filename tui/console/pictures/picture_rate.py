"""Decides when the next picture may go to the terminal and how fine it is, from the measured rate of the link; pure.

One picture is under way at a time: the next waits until the terminal has answered for the last one, so a slow link
never holds more than one. How long a picture takes decides its detail, the rate of the link how often one is sent.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from tui.console.pictures.raster import DETAILS, PictureDetail

TOO_LONG_S = 0.15
"""A picture that holds the link longer is followed by coarser ones: a key's echo waits no longer than this."""
SHORT_S = 0.03
CALM_PICTURES = 8
"""After so many quick pictures in a row the next finer detail is tried."""
BARRED_S = 20.0
"""After a picture that took too long no finer detail is tried for so long."""
SHARE = 0.5
"""Pictures get at most this share of the link's time."""
STALLED_S = 1.0
"""A terminal that has not answered for so long is stalled: nothing more is painted until it does."""
DEAF_S = 3.0
"""A terminal that has not answered its first question for so long never answers any."""
SMOOTH = 0.3
"""Weight of the newest measurement in the running average of the link's rate."""
BARE_BYTES = 2000
"""A question behind no more than this measures the link's own delay."""
BARE_EVERY_S = 10.0


@dataclass
class PictureRate:
    """Takes times and bytes; all times are monotonic seconds."""

    wanted_hz: float = 5.0
    """Pictures per second on a fast link."""
    base_s: float | None = None
    """Round trip of a question behind nothing: the link's own delay, which no lower rate shortens; None: not known."""
    rate_bytes_per_s: float | None = None
    """Rate of the link; None until something large enough was sent."""
    deaf: bool = False
    """True if the terminal answers no questions: then only our own queue is known."""
    answers: int = 0
    _step: int = 0
    _calm: int = 0
    _next_s: float = float("-inf")
    _asked_s: float | None = None
    _asked_bytes: int = 0
    _sent_s: list[float] = field(default_factory=list)
    _barred_until_s: float = float("-inf")
    _bare_s: float = float("-inf")

    @property
    def detail(self) -> PictureDetail:
        """How fine the next picture is drawn."""
        return DETAILS[self._step]

    @property
    def asking(self) -> bool:
        """True while an answer is awaited."""
        return self._asked_s is not None

    def may_send(self, now_s: float, backlog_bytes: int) -> bool:
        """True if a picture may be painted now."""
        self._give_up(now_s)
        known = self.base_s is not None or self.deaf
        return known and self._asked_s is None and now_s >= self._next_s and not backlog_bytes

    def wants_bare(self, now_s: float) -> bool:
        """True if the terminal should be asked now without a picture before the question."""
        self._give_up(now_s)
        return not self.deaf and self._asked_s is None and now_s - self._bare_s > BARE_EVERY_S

    def asked(self, now_s: float, nbytes: int, *, picture: bool = True) -> None:
        """A question was handed to the terminal, ``nbytes`` after the last one, most of them a picture's."""
        if picture:
            self._sent_s = [at_s for at_s in self._sent_s if now_s - at_s < 2.0] + [now_s]
            self._next_s = now_s + 1.0 / self.wanted_hz
        else:
            self._bare_s = now_s
        if not self.deaf:
            self._asked_s, self._asked_bytes = now_s, nbytes

    def answered(self, now_s: float) -> None:
        """The terminal has processed everything up to the question."""
        if self._asked_s is None:
            return
        took_s, self._asked_s = now_s - self._asked_s, None
        self.answers += 1
        if self.base_s is None or self._asked_bytes <= BARE_BYTES:
            self.base_s = took_s
            return
        self.base_s = min(self.base_s, took_s)
        held_s = took_s - self.base_s
        if held_s > SHORT_S / 2:
            rate = self._asked_bytes / held_s
            known = self.rate_bytes_per_s
            self.rate_bytes_per_s = rate if known is None else known + SMOOTH * (rate - known)
        self._next_s = max(self._next_s, now_s + held_s * (1.0 / SHARE - 1.0))
        self._adapt(held_s, now_s)

    def _adapt(self, held_s: float, now_s: float) -> None:
        if held_s > TOO_LONG_S:
            self._step = min(len(DETAILS) - 1, self._step + 1)
            self._calm, self._barred_until_s = 0, now_s + BARRED_S
        elif held_s < SHORT_S:
            self._calm += 1
            if self._calm >= CALM_PICTURES and self._step and now_s > self._barred_until_s:
                self._step, self._calm = self._step - 1, 0
        else:
            self._calm = 0

    def _give_up(self, now_s: float) -> None:
        if self._asked_s is not None and not self.answers and now_s - self._asked_s > DEAF_S:
            self.deaf, self._asked_s = True, None

    def stalled(self, now_s: float, blocked_s: float) -> bool:
        """True while painting would only fill a queue: the last answer, or our write (``blocked_s``), is overdue."""
        self._give_up(now_s)
        waiting_s = now_s - self._asked_s if self._asked_s is not None and self.answers else 0.0
        return max(waiting_s, blocked_s) > STALLED_S

    def words(self, now_s: float) -> str:
        """``link 180 kB/s, picture 3 Hz``; unknown values are left out."""
        sent = sum(now_s - at_s < 2.0 for at_s in self._sent_s)
        words = f"picture {sent / 2.0:.3g} Hz"
        if self.rate_bytes_per_s is not None:
            words = f"link {self.rate_bytes_per_s / 1000:.0f} kB/s, {words}"
        return f"{words}, coarser" if self._step else words
