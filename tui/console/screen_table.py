"""The screens in the order of their number keys: names and summaries; ``screens.registry`` has the classes."""

from __future__ import annotations

from typing import NamedTuple


class ScreenEntry(NamedTuple):
    """One row of the table of screens."""

    name: str
    summary: str
    """What one does there, for the palette."""


SCREENS: tuple[ScreenEntry, ...] = (
    ScreenEntry("scan", "picture, stage, light, sweep"),
    ScreenEntry("reconstruct", "maps, contrast, cloud"),
    ScreenEntry("calibrate", "camera and light plane"),
    ScreenEntry("scans", "the folder of scans"),
    ScreenEntry("faults", "what happened, what is safe, what to do"),
    ScreenEntry("log", "all messages of this session"),
)
"""Number key 1 is the first row, and so on."""
