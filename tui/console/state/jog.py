"""Turns key presses into bounded moves: one in flight, at most one waiting, whatever the keyboard repeats; pure."""

from __future__ import annotations

from dataclasses import dataclass

MIN_GAP_S = 0.05
"""At most twenty moves per second."""
STEP_SIZES = (1, 3, 10, 30, 100, 300)
"""Sizes of the fine step in microsteps; the fast one is ten times as large."""
FAST_FACTOR = 10
HOLD_EVERY_S = 0.08
"""Least time between two renewals of the lease by a held key."""
ANSWER_S = 6.0
"""After this time a move whose end was not reported no longer blocks others."""


@dataclass(frozen=True)
class ClippedMove:
    """A move within the travel."""

    steps: int
    """What is left of the move; 0: nothing."""
    words: str
    """Which limit shortened it; empty if none did."""


def clip(position_steps: int, steps: int, travel_steps: tuple[int, int], um_per_microstep: float) -> ClippedMove:
    """``steps`` shortened to the travel, with the limit that shortened it."""
    low, high = travel_steps
    if low >= high:
        return ClippedMove(steps, "")
    wanted = position_steps + steps
    target = min(wanted, max(high, position_steps)) if steps > 0 else max(wanted, min(low, position_steps))
    left = target - position_steps
    if target == wanted:
        return ClippedMove(steps, "")
    name = "upper" if steps > 0 else "lower"
    return ClippedMove(left, f"the {name} limit is {target} microsteps ({target * um_per_microstep:.1f} um)")


class JogGate:
    """One move in flight and at most one that waits."""

    def __init__(self) -> None:
        self._waiting = 0
        self._in_flight = False
        self._answered_ns: int | None = None
        self._since_s = float("-inf")
        self._held_s = float("-inf")

    def press(self, steps: int, now_s: float) -> int:
        """A key was pressed; returns the microsteps to send now, 0 to send nothing."""
        if self.in_flight(now_s) or now_s - self._since_s < MIN_GAP_S:
            self._waiting = self._waiting or steps
            return 0
        return self._send(steps, now_s)

    def in_flight(self, now_s: float) -> bool:
        """True while a move of ours is in flight: a press waits for its end."""
        return self._in_flight and now_s - self._since_s < ANSWER_S

    def _send(self, steps: int, now_s: float) -> int:
        self._in_flight, self._answered_ns, self._since_s, self._waiting = True, None, now_s, 0
        return steps

    def answered(self, *, ok: bool, at_ns: int) -> None:
        """The daemon accepted the move, or refused it."""
        self._answered_ns = at_ns
        if not ok:
            self._in_flight, self._waiting = False, 0

    def take_status(self, *, moving: bool, sent_ns: int, now_s: float) -> int:
        """A status arrived; returns the microsteps of the waiting move if it may be sent now, else 0."""
        if self._in_flight and self._answered_ns is not None and sent_ns >= self._answered_ns and not moving:
            self._in_flight = False
        if self._in_flight or not self._waiting or now_s - self._since_s < MIN_GAP_S:
            return 0
        return self._send(self._waiting, now_s)

    def forget(self) -> None:
        """STOP: drop the waiting move."""
        self._waiting = 0

    def hold(self, now_s: float) -> bool:
        """A repeat of a held key; True if the lease must be renewed now."""
        if now_s - self._held_s < HOLD_EVERY_S:
            return False
        self._held_s = now_s
        return True


def next_size(size: int, direction: int) -> int:
    """The next larger (1) or smaller (-1) fine step."""
    index = min(range(len(STEP_SIZES)), key=lambda at: abs(STEP_SIZES[at] - size))
    return STEP_SIZES[max(0, min(len(STEP_SIZES) - 1, index + direction))]
