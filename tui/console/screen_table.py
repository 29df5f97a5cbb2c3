"""The screens of the console in the order of their number keys, loaded when they are first looked at."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tui.console.screens.base import RigScreenBase


@dataclass(frozen=True)
class ScreenEntry:
    """One row of the table of screens."""

    name: str
    words: str
    """What one does there, for the palette."""
    place: str
    """``module:Class``; the class is a :class:`RigScreenBase` made with ``ascii_only``."""

    def make(self, *, ascii_only: bool) -> RigScreenBase:
        """A new screen."""
        module, _, name = self.place.partition(":")
        screen: RigScreenBase = getattr(importlib.import_module(module), name)(ascii_only=ascii_only)
        return screen


SCREENS: tuple[ScreenEntry, ...] = (
    ScreenEntry("scan", "picture, stage, light, sweep", "tui.console.screens.scan:ScanScreen"),
    ScreenEntry("reconstruct", "maps, contrast, cloud", "tui.console.screens.reconstruct:ReconstructScreen"),
    ScreenEntry("calibrate", "camera and light plane", "tui.console.screens.calibrate:CalibrateScreen"),
    ScreenEntry("scans", "the folder of scans", "tui.console.screens.scans:ScansScreen"),
    ScreenEntry("faults", "what happened, what is safe, what to do", "tui.console.screens.faults:FaultsScreen"),
    ScreenEntry("log", "all news of this session", "tui.console.screens.log:LogScreen"),
)
"""Number key 1 is the first row, and so on."""
