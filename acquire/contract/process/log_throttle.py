"""Log throttling: an event that repeats is logged at powers of ten, so that it cannot fill the disk."""

from __future__ import annotations

import logging


def is_power_of_ten(count: int) -> bool:
    """True for 1, 10, 100 ..."""
    return count > 0 and str(count).strip("0") == "1"


class Threshold:
    """Detects that a growing count has reached the next power of ten."""

    def __init__(self, first: int) -> None:
        self._next = first

    def reached(self, count: int) -> bool:
        """True once for each power of ten times ``first`` that ``count`` has reached."""
        if count < self._next:
            return False
        while self._next <= count:
            self._next *= 10
        return True


def log_throttled(logger: logging.Logger, count: int, text: str) -> None:
    """Log the first ten events of a kind, then the 100th, the 1000th ..."""
    if count <= 10 or is_power_of_ten(count):
        logger.warning("%s (%d so far)", text, count)
