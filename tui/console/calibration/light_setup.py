"""Brings the light over the board, then has the exposure searched there: after a sweep the stage may stand anywhere.

Pure: what the rig says in, commands out. A STOP, a stage that rests elsewhere, or too long a wait ends it.
"""

from __future__ import annotations

from typing import Any

from acquire.contract.messaging.messages import Status
from acquire.contract.states import State

Command = tuple[str, dict[str, Any]]
MOVE_S = 60.0
"""A move that takes longer is not waited for."""


class BringLight:
    """One search at a time."""

    def __init__(self) -> None:
        self._target: int | None = None
        self._until_s = 0.0
        self._moved = False

    def begin(self, target_steps: int, status: Status, now_s: float) -> list[Command]:
        """The first commands: the lamp where it is off, and a move, or the search at once where the light stands."""
        lamp: list[Command] = [] if status.lamp_on else [("lamp", {"on": True})]
        if status.position_steps == target_steps:
            return [*lamp, ("expose", {})]
        self._target, self._until_s, self._moved = target_steps, now_s + MOVE_S, False
        return [*lamp, ("goto", {"position_steps": target_steps})]

    def forget(self) -> None:
        """The move was refused, or stopped, or nobody looks any more."""
        self._target = None

    def heard(self, status: Status, now_s: float, *, stopped: bool) -> list[Command]:
        """A status came: the search, if the light is there."""
        if self._target is None:
            return []
        if stopped or now_s > self._until_s:
            self.forget()
            return []
        moving = status.state == State.MOVING
        self._moved = self._moved or moving
        there = not moving and status.position_steps == self._target
        if there or (self._moved and not moving):
            self.forget()
        return [("expose", {})] if there else []
