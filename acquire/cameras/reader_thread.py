"""Reader thread of a camera driver: reads all the time, so that no old picture waits in a buffer."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

logger = logging.getLogger(__name__)
AGAIN_S = 1.0
_JOIN_S = 10.0
"""A read that is under way may take so long to come back."""


class ReaderThread:
    """Runs ``serve`` in a thread; ``serve`` must return soon after :attr:`ending` has become true."""

    def __init__(self, name: str, serve: Callable[[], None]) -> None:
        self._name, self._serve = name, serve
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def ending(self) -> bool:
        """True when ``serve`` must return."""
        return self._ending.is_set()

    def begin(self) -> None:
        """Start the thread."""
        self._ending.clear()
        self._thread = threading.Thread(target=self._serve, name=self._name, daemon=True)
        self._thread.start()

    def until_back(self, reopen: Callable[[], None], errors: tuple[type[Exception], ...]) -> bool:
        """Called from ``serve``: try to reconnect once a second; False if the thread was ended meanwhile."""
        said = ""
        while not self._ending.wait(AGAIN_S):
            try:
                reopen()
            except errors as error:
                if str(error) != said:
                    said = str(error)
                    logger.info("the camera is not back yet: %s", said)
                continue
            logger.info("the camera is back")
            return True
        return False

    def end(self) -> None:
        """End the thread and wait for it; idempotent."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(timeout=_JOIN_S)
            self._thread = None
