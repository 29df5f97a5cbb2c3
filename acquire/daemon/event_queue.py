"""Events from device threads to the daemon's loop: ordered, and they wake the loop at once."""

from __future__ import annotations

import os
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class EventQueue(Generic[T]):
    """A queue with a file descriptor that a poller can watch. Any thread puts, one thread takes.

    It needs no bound: the stage does one thing at a time, and the camera takes one exposure per credit.
    """

    def __init__(self) -> None:
        self._events: deque[T] = deque()
        self._fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)

    def fileno(self) -> int:
        """Readable while there are events."""
        return self._fd

    def put(self, event: T) -> None:
        """Add an event and wake the loop."""
        self._events.append(event)
        os.eventfd_write(self._fd, 1)

    def take_all(self) -> list[T]:
        """All events, in order."""
        try:
            os.eventfd_read(self._fd)
        except BlockingIOError:
            return []
        # bounded by what is there now, so that a thread that keeps putting cannot hold the loop
        return [self._events.popleft() for _ in range(len(self._events))]

    def close(self) -> None:
        """Close the descriptor; no thread may put any more."""
        os.close(self._fd)
