"""Events from device threads to the daemon's loop: ordered, and they wake the loop at once."""

from __future__ import annotations

import os
from collections import deque
from typing import Any


class Inbox:
    """A queue with a file descriptor that a poller can watch. Any thread puts, one thread takes.

    It needs no bound of its own: at most one activity of the stage and one exposure per credit are under way.
    """

    def __init__(self) -> None:
        self._events: deque[Any] = deque()
        self._fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)

    def fileno(self) -> int:
        """Readable while there is something."""
        return self._fd

    def put(self, event: Any) -> None:
        """Add an event and wake the loop."""
        self._events.append(event)
        os.eventfd_write(self._fd, 1)

    def take_all(self) -> list[Any]:
        """Everything that has come, in order."""
        try:
            os.eventfd_read(self._fd)
        except BlockingIOError:
            return []
        events = []
        while self._events:
            events.append(self._events.popleft())
        return events

    def close(self) -> None:
        """Give the descriptor back; no thread may put any more."""
        os.close(self._fd)
