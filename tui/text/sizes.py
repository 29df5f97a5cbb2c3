"""Sizes as people type them."""

from __future__ import annotations

import re


def parse_size(text: str) -> tuple[int, int]:
    """Width and height in pixels of ``WIDTHxHEIGHT``.

    Raises:
        ValueError: it is not of that form.
    """
    found = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text)
    if found is None:
        raise ValueError(f"{text!r} is no size: give WIDTHxHEIGHT in pixels, for example 1024x768")
    return int(found[1]), int(found[2])


def parse_squares(text: str) -> tuple[int, int]:
    """Squares of a board along both sides: ``10x7``, also ``10X7``, ``10 x 7``, ``10*7`` or ``10,7``; 3 to 200 each.

    Raises:
        ValueError: it is not of that form, or out of range.
    """
    found = re.fullmatch(r"\s*(\d{1,6})\s*[xX\u00d7*,;:/ ]\s*(\d{1,6})\s*", text, re.ASCII)
    what = "give the squares of the board along both sides (squares, not inner corners; of dots the dots), such as 10x7"
    if found is None:
        raise ValueError(f"{text!r} is no board: {what}")
    columns, rows = int(found[1]), int(found[2])
    if min(columns, rows) < 3 or max(columns, rows) > 200:
        raise ValueError(f"{text!r}: a board has 3 to 200 squares along each side; {what}")
    return columns, rows
