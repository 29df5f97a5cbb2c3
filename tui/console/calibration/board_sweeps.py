"""The sweeps over the board that the light plane may be calibrated with, and which of them count. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.text import Text

from tui.console.calibration.texts import sweep_words
from tui.scans.folder import ScanEntry


class BoardSweeps:
    """Every sealed sweep counts until it is taken out."""

    def __init__(self) -> None:
        self.entries: list[ScanEntry] = []
        self._left_out: set[str] = set()

    def take(self, found: Sequence[ScanEntry]) -> None:
        """What the folder of scans holds now."""
        self.entries = [entry for entry in found if entry.purpose == "calibration"]

    def toggle(self, key: str) -> None:
        """Take a sweep out, or in again; ``key`` as in :attr:`keys`."""
        self._left_out ^= {key}

    @property
    def used(self) -> list[Path]:
        """Folders of those that count."""
        return [entry.folder for entry in self.entries if self._counts(entry)]

    @property
    def keys(self) -> list[str]:
        """What tells the rows apart."""
        return [str(entry.folder) for entry in self.entries]

    def rows(self, *, ascii_only: bool) -> list[Text]:
        """One line for each: whether it counts, its name, how it ended."""
        used, not_used = ("x", " ") if ascii_only else ("✓", "·")
        return [
            Text(f"{used if self._counts(entry) else not_used}  {entry.folder.name}  {sweep_words(entry)}")
            for entry in self.entries
        ]

    def _counts(self, entry: ScanEntry) -> bool:
        return str(entry.folder) not in self._left_out and entry.state == "sealed" and entry.committed > 0
