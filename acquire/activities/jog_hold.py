"""Motion while a key is held: key presses renew a lease, and the way is bounded."""

from __future__ import annotations

from typing import ClassVar, Final

from acquire.contract.units import NS_PER_MS
from acquire.stages.protocol import Moved, Stage

from .base import Activity, Rest

LEASE_MS: Final = 300
"""The stage stops when the lease was not renewed for so long."""
MOST_STEPS: Final = 2000
"""Longest way of one hold, in microsteps; then the key must be released."""


class JogHold(Activity):
    """One hold, from the first key press until the stage rests."""

    name: ClassVar[str] = "jog"
    moves: ClassVar[bool] = True

    def __init__(self, stage: Stage, *, direction: int, target_steps: int, limit: str, rate_steps_per_s: float) -> None:
        """``limit`` names what ends the hold at ``target_steps``."""
        super().__init__()
        self.direction, self.target_steps, self.limit = direction, target_steps, limit
        self._stage, self._rate = stage, rate_steps_per_s
        self._until_ns = 0
        self._stopping = False

    def begin(self, now_ns: int) -> None:
        """Move toward the bound."""
        self.renew(now_ns)
        self._stage.move_to(self.target_steps, self._rate)

    def renew(self, now_ns: int) -> None:
        """The key is still held."""
        self._until_ns = now_ns + LEASE_MS * NS_PER_MS

    def let_go(self) -> None:
        """The key was released."""
        self._until_ns = 0

    def on_tick(self, now_ns: int) -> None:
        """Stop when the lease has run out."""
        if now_ns > self._until_ns and not self._stopping:
            self._stopping = True
            self._stage.stop()

    def on_rest(self, event: Rest, now_ns: int) -> None:
        """The hold is over: released, at its bound, or stopped."""
        reached = isinstance(event, Moved) and event.position_steps == self.target_steps
        self.end(f"at {event.position_steps} microsteps{f', {self.limit}' if reached else ''}")
