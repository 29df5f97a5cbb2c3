"""Cuts and pads text to a width in terminal cells; pure."""

from __future__ import annotations


def shorten(text: str, width: int) -> str:
    """``text`` in at most ``width`` cells; the middle of a longer one gives way to three dots."""
    if len(text) <= width:
        return text
    if width <= 3:
        return text[:width]
    tail = (width - 3) // 2
    return text[: width - 3 - tail] + "..." + (text[-tail:] if tail else "")


def spread(left: str, right: str, width: int) -> str:
    """``left`` and ``right`` at the two ends of a line of ``width`` cells; the left one is shortened first."""
    room = width - len(right) - 2
    if room <= 0:
        return shorten(right, width)
    left = shorten(left, room)
    return left + " " * (width - len(left) - len(right)) + right
