"""Text of a given width in terminal cells; wide characters (CJK, emoji) take two; pure."""

from __future__ import annotations

from rich.cells import cell_len, set_cell_size


def shorten(text: str, width: int) -> str:
    """``text`` in at most ``width`` cells; the middle of a longer text is replaced by three dots."""
    if cell_len(text) <= width:
        return text
    tail = max(0, (width - 3) // 2)
    if width <= 3:
        return set_cell_size(text, width)
    return set_cell_size(text, width - 3 - tail) + "..." + set_cell_size(text[::-1], tail)[::-1]


def padded(text: str, width: int) -> str:
    """``text`` shortened to less than ``width`` cells and filled with spaces, for the column of a table."""
    return set_cell_size(shorten(text, width - 1), width)
