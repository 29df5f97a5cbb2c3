"""Says in the log what happens again and again, without letting it fill the disk."""

from __future__ import annotations

import logging


def is_worth_saying(count: int) -> bool:
    """True for the 1st, 10th, 100th, 1000th ... of a kind."""
    return count > 0 and str(count).strip("0") == "1"


def log_now_and_then(logger: logging.Logger, count: int, text: str) -> None:
    """Log the first ten of a kind, then the 100th, the 1000th ..."""
    if count <= 10 or is_worth_saying(count):
        logger.warning("%s (%d so far)", text, count)
