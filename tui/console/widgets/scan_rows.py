"""A scan as a row of the list of scans, and in full below it."""

from __future__ import annotations

from datetime import datetime

from rich.text import Text

from acquire.contract.units import format_bytes
from tui.console.jobs import Job
from tui.console.widgets.lines import Pane
from tui.scans.folder import ScanEntry
from tui.text.width import padded, shorten

_SIGNS = {"SAVED": "✓", "running": "▶", "interrupted": "‖", "unreadable": "✖"}
_WORKING_SIGN = "◐"
_STYLES = {"SAVED": "green", "running": "bold #4aa3ff", "unreadable": "bold red", "failed": "bold red"}


def columns_of(width: int) -> list[tuple[str, int]]:
    """Names and cells of the columns that fit; the name gets what is left."""
    fixed = [("outcome", 17), ("points", 10), ("size", 10), ("age", 9)]
    if width >= 110:
        fixed += [("calibrated", 12), ("copies", 12), ("specimen", 24)]
    name = max(16, width - 2 - sum(cells for _, cells in fixed))
    return [("", 2), ("name", name), *fixed]


def row_of(entry: ScanEntry, job: Job | None, columns: list[tuple[str, int]], now: datetime) -> Text:
    """One row; ``job`` is what works on the scan now."""
    first = entry.outcome_words.split()[0]
    cells = {
        "": _WORKING_SIGN if job else _SIGNS.get(first, "!"),
        "name": entry.notes.name if entry.notes.edited_utc and entry.notes.name else entry.folder.name,
        "outcome": _outcome(entry, job),
        "points": "-" if entry.points is None else f"{entry.points:,}".replace(",", " "),
        "size": format_bytes(entry.size_bytes),
        "age": entry.age_words(now),
        "calibrated": entry.calibration_words,
        "copies": f"{len(entry.copies)} verified" if entry.copies else "-",
        "specimen": entry.notes.specimen,
    }
    row = Text()
    for name, width in columns:
        row.append(padded(cells[name], width), style=_STYLES.get(first, "yellow") if name in ("", "outcome") else "")
    return row


def _outcome(entry: ScanEntry, job: Job | None) -> str:
    if job is None:
        return entry.outcome_words
    return job.title.split()[0] + (f" {100 * job.share:.0f} %" if job.share is not None else " ...")


class ScanDetail(Pane[tuple[ScanEntry | None, str]]):
    """The chosen scan in full, and the result of the last work on it."""

    DEFAULT_CSS = """
    ScanDetail { height: 7; }
    .wide ScanDetail { height: 12; }
    """

    def text_for(self, width: int) -> Text:
        """Lines cut to the pane."""
        entry, last_result = self.shown
        if entry is None:
            return Text("no scan is chosen", style="dim")
        lines = [Text(shorten(line, width)) for line in entry.lines()]
        if last_result:
            lines.insert(0, Text(shorten(last_result, width), style="bold"))
        return Text("\n", no_wrap=True).join(lines)
