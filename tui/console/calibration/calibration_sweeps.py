"""The sweeps over the board from which the light plane can be calibrated, and which of them are used; pure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.text import Text

from tui.console.calibration.results import sweep_words
from tui.scans.folder import ScanEntry


class CalibrationSweeps:
    """Every sealed sweep is used until it is taken out."""

    def __init__(self) -> None:
        self.entries: list[ScanEntry] = []
        self._left_out: set[str] = set()

    def take(self, scans: Sequence[ScanEntry]) -> None:
        """The newest list of scans."""
        self.entries = [entry for entry in scans if entry.purpose == "calibration"]

    def toggle(self, key: str) -> None:
        """Take a sweep out, or in again; ``key`` as in :attr:`keys`."""
        self._left_out ^= {key}

    @property
    def used(self) -> list[Path]:
        """Folders of the sweeps that are used."""
        return [entry.folder for entry in self.entries if self._is_used(entry)]

    @property
    def keys(self) -> list[str]:
        """One key per row."""
        return [str(entry.folder) for entry in self.entries]

    def rows(self) -> list[Text]:
        """For each sweep: whether it is used, its name, how it ended."""
        return [
            Text(f"{'✓' if self._is_used(entry) else '·'}  {entry.folder.name}  {sweep_words(entry)}")
            for entry in self.entries
        ]

    def _is_used(self, entry: ScanEntry) -> bool:
        return str(entry.folder) not in self._left_out and entry.state == "sealed" and entry.committed > 0
