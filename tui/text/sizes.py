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
