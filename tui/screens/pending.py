"""Places of screens that this version does not have yet: each says so and names the command that does it today."""

from __future__ import annotations

from textual.app import ComposeResult
from textual.widgets import Static

from tui.screens.base import RigScreenBase


class _Pending(RigScreenBase):
    WORDS = ""

    def body(self) -> ComposeResult:
        """One sentence."""
        yield Static(self.WORDS, markup=False)


class ReconstructScreen(_Pending):
    """Maps and cloud."""

    NAME = "reconstruct"
    WORDS = "This screen is not there yet: use 'sweepscope reconstruct SCAN'."


class CalibrateScreen(_Pending):
    """Camera and light plane."""

    NAME = "calibrate"
    WORDS = "This screen is not there yet: use 'sweepscope calibrate --help'."


class ScansScreen(_Pending):
    """The folder of scans."""

    NAME = "scans"
    WORDS = "This screen is not there yet: use 'sweepscope info SCAN' and 'sweepscope verify SCAN'."


class FaultsScreen(_Pending):
    """All faults."""

    NAME = "faults"
    WORDS = "This screen is not there yet: the newest fault is in the banner of every screen."


class LogScreen(_Pending):
    """All news."""

    NAME = "log"
    WORDS = "This screen is not there yet: the newest lines are on the scan screen (1)."
