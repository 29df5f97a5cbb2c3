"""STOP from the key press to the rig's own word: what was sent, what is confirmed, what the screens say meanwhile."""

from __future__ import annotations

from acquire.contract.messaging.messages import Status
from acquire.contract.states import State
from tui.text.status_text import MOVING_STATES, position_words

_MOVING = MOVING_STATES - {State.PREVIEW}


class StopWatch:
    """The thread that reads the keys sends STOP; the loop announces it, in whatever order the two are heard of."""

    def __init__(self) -> None:
        self.words = ""
        """What the screens show until the rig has confirmed; empty when nothing is open."""
        self._unannounced = 0
        self._keys_to_swallow = 0
        self._answered_ns: int | None = None

    def sent_early(self) -> None:
        """STOP was sent by the thread that reads the keys; the key itself follows through the loop."""
        self._unannounced += 1

    def pressed(self) -> bool:
        """The key came through the loop; True if STOP has still to be sent."""
        if self._keys_to_swallow:
            self._keys_to_swallow -= 1
            return False
        must_send = not self._unannounced
        self._unannounced = max(0, self._unannounced - 1)
        self._announce()
        return must_send

    def _announce(self) -> None:
        self._answered_ns = None
        self.words = "STOP sent"

    def answered(self, *, ok: bool, at_mono_ns: int) -> None:
        """The daemon took it, or it was given up; this may be heard before the key itself."""
        if self._unannounced:
            self._unannounced -= 1
            self._keys_to_swallow += 1
            self._announce()
        self._answered_ns = at_mono_ns
        if not ok:
            self.words = "STOP NOT CONFIRMED"

    def judge(self, status: Status) -> str:
        """Confirmed by the rig's state alone, said after the daemon had taken the command; returns the line to say."""
        if not self.words or self._answered_ns is None or status.sent_mono_ns < self._answered_ns:
            return ""
        if status.state == State.FINISHING:
            self.words = "STOP taken: saving what was taken"
        elif status.state not in _MOVING:
            self.words = ""
            return f"stopped at {position_words(status)}"
        return ""
