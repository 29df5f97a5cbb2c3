"""An activity whose work is done in a thread, so that the daemon's loop goes on."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Final

from acquire.contract.errors import SweepscopeError
from acquire.contract.units import NS_PER_S

from .base import Activity

DEADLINE_NS: Final = 60 * NS_PER_S


class Background(Activity):
    """Does ``work`` in a thread; its return value, or its error, is shown as how the activity ended."""

    def __init__(self) -> None:
        super().__init__()
        self._thread: threading.Thread | None = None
        self._began_ns = 0
        self._words = ""
        self._error = ""

    def do(self, work: Callable[[], str], now_ns: int) -> None:
        """Begin the work."""
        self._began_ns = now_ns
        self._thread = threading.Thread(target=self._run, args=(work,), name=self.name, daemon=True)
        self._thread.start()

    def _run(self, work: Callable[[], str]) -> None:
        try:
            self._words = work()
        except (SweepscopeError, OSError, ValueError, MemoryError) as error:
            self._error = " ".join(str(error).split()) or type(error).__name__

    def on_tick(self, now_ns: int) -> None:
        """End when the thread has ended, or after ``DEADLINE_NS``."""
        if self._thread is None:
            return
        if not self._thread.is_alive():
            self.end(self._error or self._words, failed=bool(self._error))
        elif now_ns - self._began_ns > DEADLINE_NS:
            self.end(f"not done within {DEADLINE_NS // NS_PER_S} s; given up", failed=True)
