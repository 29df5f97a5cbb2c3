"""Hands news to the screen in bundles, the next only when the last was taken: a slow terminal is never flooded.

Of what is only worth seeing when it is new (state, pictures, maps) the newest waits; lines of news wait all, in order.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from textual.message import Message as UiMessage

from tui.console.link.messages import News

PAINT_S = 0.1
"""The screen is told at most so often; what came between is passed over for the newest. A new state is told at once."""
MAX_TOLD = 1000
"""Lines of news that are kept while the screen takes none; older ones go."""


class NewsDesk:
    """Belongs to one thread; only the screen's taking comes from another."""

    def __init__(self, post: Callable[[UiMessage], Any], wake: Callable[[], None]) -> None:
        """``post`` must be safe to call from any thread; ``wake`` is called from the screen's when it has taken."""
        self._post, self._wake = post, wake
        self._newest: dict[str, UiMessage] = {}
        self._told: deque[UiMessage] = deque(maxlen=MAX_TOLD)
        self._unseen = threading.Event()
        self._urgent = False
        self._painted_at_s = 0.0

    def tell(self, message: UiMessage) -> None:
        """A line of news."""
        self._told.append(message)

    def show(self, kind: str, message: UiMessage, *, urgent: bool = False) -> None:
        """The newest of its kind; an urgent one does not wait for its turn."""
        self._newest[kind] = message
        self._urgent |= urgent

    def paint(self) -> None:
        """Tell the screen what is new, unless it still has not taken what it was told last: then the newest waits."""
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
        self._post(News(parts, self._taken))

    def _taken(self) -> None:
        self._unseen.clear()
        self._wake()
