"""Hands updates to the screen in bundles, the next only when the last was taken: a slow terminal is never flooded.

Of states, pictures and maps only the newest waits; everything else waits in its order.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from tui.console.link.messages import Update, Updates

PAINT_S = 0.1
"""Least time between two bundles; of what came between, the newest is shown. A new state does not wait."""
MAX_TOLD = 1000
"""Messages that are kept while the screen takes none; older ones are dropped."""


class UpdateQueue:
    """Belongs to one thread; only ``taken`` is called from the screen's."""

    def __init__(self, post: Callable[[Updates], Any], wake: Callable[[], None]) -> None:
        """``post`` may be called from any thread; ``wake`` is called from the screen's when a bundle was taken."""
        self._post, self._wake = post, wake
        self._newest: dict[str, Update] = {}
        self._told: deque[Update] = deque(maxlen=MAX_TOLD)
        self._unseen = threading.Event()
        self._urgent = False
        self._painted_at_s = 0.0

    def tell(self, message: Update) -> None:
        """One more message, after those before it."""
        self._told.append(message)

    def show(self, kind: str, message: Update, *, urgent: bool = False) -> None:
        """The newest of its kind replaces the one before; an urgent one does not wait for ``PAINT_S``."""
        self._newest[kind] = message
        self._urgent |= urgent

    def paint(self) -> None:
        """Post what is new as one bundle, unless the screen has not taken the last one yet."""
        now_s = time.monotonic()
        due = bool(self._newest) and (self._urgent or now_s - self._painted_at_s >= PAINT_S)
        if self._unseen.is_set() or not (due or self._told):
            return
        parts = list(self._told)
        self._told.clear()
        if due:
            self._painted_at_s, self._urgent = now_s, False
            parts += self._newest.values()
            self._newest.clear()
        self._unseen.set()
        self._post(Updates(parts, self._taken))

    def _taken(self) -> None:
        self._unseen.clear()
        self._wake()
