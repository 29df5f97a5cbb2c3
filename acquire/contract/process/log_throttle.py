"""Says in the log what happens again and again, without letting it fill the disk."""

from __future__ import annotations

import logging


def is_worth_saying(count: int) -> bool:
    """True for the 1st, 10th, 100th, 1000th ... of a kind."""
    return count > 0 and str(count).strip("0") == "1"


class Threshold:
    """Says when a count has grown to the next power of ten that is worth telling people of."""

    def __init__(self, first: int) -> None:
        self._next = first

    def reached(self, count: int) -> bool:
        """True once for each power of ten times the first threshold that ``count`` has come to."""
        if count < self._next:
            return False
        while self._next <= count:
            self._next *= 10
        return True


def log_now_and_then(logger: logging.Logger, count: int, text: str) -> None:
    """Log the first ten of a kind, then the 100th, the 1000th ..."""
    if count <= 10 or is_worth_saying(count):
        logger.warning("%s (%d so far)", text, count)
