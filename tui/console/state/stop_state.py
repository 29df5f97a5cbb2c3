"""STOP from the key to the confirmation by the rig's own state; pure.

The thread that reads the keys sends STOP, the event loop announces it; either may come first.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from acquire.contract.messaging.messages import Status
from acquire.contract.states import RUNNING_STATES, State
from tui.text.status_text import position_words

_MOVING = RUNNING_STATES | {State.HOMING, State.MOVING}


class StopState:
    """What was sent and what is confirmed."""

    def __init__(self, on_sent: Callable[[], Any] = lambda: None) -> None:
        """``on_sent`` is called once for each STOP, before anything else is said of it."""
        self._on_sent = on_sent
        self.words = ""
        """What the screens show until the rig has confirmed the stop; empty otherwise."""
        self._unannounced = 0
        self._keys_to_ignore = 0
        self._answered_ns: int | None = None

    def sent_early(self) -> None:
        """The thread that reads the keys has sent STOP; the key itself follows through the loop."""
        self._unannounced += 1

    def pressed(self) -> bool:
        """The key arrived through the loop; True if STOP must still be sent."""
        if self._keys_to_ignore:
            self._keys_to_ignore -= 1
            return False
        must_send = not self._unannounced
        self._unannounced = max(0, self._unannounced - 1)
        self._announce()
        return must_send

    def _announce(self) -> None:
        self._answered_ns = None
        self.words = "STOP sent"
        self._on_sent()

    def answered(self, *, ok: bool, at_mono_ns: int) -> None:
        """The daemon accepted STOP, or never answered; this may come before the key itself."""
        if self._unannounced:
            self._unannounced -= 1
            self._keys_to_ignore += 1
            self._announce()
        self._answered_ns = at_mono_ns
        if not ok:
            self.words = "STOP NOT CONFIRMED"

    def take_status(self, status: Status) -> str:
        """Only a state that was sent after the daemon accepted STOP confirms it; returns the line for the log."""
        if not self.words or self._answered_ns is None or status.sent_mono_ns < self._answered_ns:
            return ""
        if status.state == State.FINISHING:
            self.words = "STOP accepted: saving the frames"
        elif status.state not in _MOVING:
            self.words = ""
            return f"stopped at {position_words(status)}"
        return ""
