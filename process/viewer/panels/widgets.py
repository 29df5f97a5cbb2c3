"""What panels share: writing to widgets, and jobs that callbacks leave for the main loop."""

from __future__ import annotations

import contextlib
import queue
from collections.abc import Callable
from typing import Any

WAITING = 32
"""Jobs that may wait for the main loop; more come from no person."""


def write(widget: Any, **values: Any) -> None:
    """Assign ``values`` (value, content, disabled, visible ...) where they differ: each is sent to every browser."""
    for name, value in values.items():
        if getattr(widget, name) != value:
            setattr(widget, name, value)


class JobQueue:
    """Any thread puts jobs in; the main loop, which alone changes cloud and widgets, runs them."""

    def __init__(self, wake: Callable[[], None]) -> None:
        """``wake`` ends the main loop's pause."""
        self._jobs: queue.Queue[Callable[[], None]] = queue.Queue(WAITING)
        self._wake = wake

    def put(self, job: Callable[[], None]) -> None:
        """Have a job run in the next turn; dropped if too many wait."""
        with contextlib.suppress(queue.Full):
            self._jobs.put_nowait(job)
        self._wake()

    def run(self) -> None:
        """Run what waits, in its order."""
        while not self._jobs.empty():
            self._jobs.get_nowait()()
