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
