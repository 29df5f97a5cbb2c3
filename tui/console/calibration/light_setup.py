"""Moves the light over the board, then searches the exposure there: after a sweep the stage may be anywhere.

Pure: status in, commands out. A STOP, a stage that rests elsewhere, or a time-out ends it.
"""

from __future__ import annotations

from typing import Any

from acquire.contract.messaging.messages import Status
from acquire.contract.states import State

CommandCall = tuple[str, dict[str, Any]]
"""A command's name and arguments."""
MOVE_S = 60.0
"""Time-out of the move."""


class LightSetup:
    """One search at a time."""

    def __init__(self) -> None:
        self._target: int | None = None
        self._until_s = 0.0
        self._moved = False

    def begin(self, target_steps: int, status: Status, now_s: float) -> list[CommandCall]:
        """The first commands: the lamp if it is off, then the move, or the search if the light is there already."""
        lamp: list[CommandCall] = [] if status.lamp_on else [("lamp", {"on": True})]
        if status.position_steps == target_steps:
            return [*lamp, ("expose", {})]
        self._target, self._until_s, self._moved = target_steps, now_s + MOVE_S, False
        return [*lamp, ("goto", {"position_steps": target_steps})]

    def forget(self) -> None:
        """The move was refused, or the screen was left."""
        self._target = None

    def take_status(self, status: Status, now_s: float, *, stopped: bool) -> list[CommandCall]:
        """The search, once the light is there."""
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
