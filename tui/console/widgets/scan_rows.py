"""How a scan looks in the list of scans, and in full below it."""

from __future__ import annotations

from datetime import datetime

from rich.text import Text

from acquire.contract.units import format_bytes
from tui.console.widgets.lines import Lines
from tui.processes.child_jobs import Job
from tui.scans.folder import ScanEntry
from tui.text.width import shorten

_SIGNS = {
    "SAVED": ("v", "✓"),
    "running": (">", "▶"),
    "work": ("~", "◐"),
    "interrupted": ("=", "‖"),
    "unreadable": ("X", "✖"),
}
_STYLES = {"SAVED": "green", "running": "bold #4aa3ff", "unreadable": "bold red", "failed": "bold red"}


def columns_of(width: int) -> list[tuple[str, int]]:
    """Names and cells of the columns that fit; the name takes what is left."""
    fixed = [("outcome", 17), ("points", 10), ("size", 10), ("age", 9)]
    if width >= 110:
        fixed += [("calibrated", 12), ("copies", 12), ("specimen", 24)]
    name = max(16, width - 2 - sum(cells for _, cells in fixed))
    return [("", 2), ("name", name), *fixed]


def title_of(entry: ScanEntry) -> str:
    """What people called it afterwards, else its folder."""
    return entry.notes.name if entry.notes.edited_utc and entry.notes.name else entry.folder.name


def row_of(
    entry: ScanEntry, job: Job | None, columns: list[tuple[str, int]], now: datetime, *, ascii_only: bool
) -> Text:
    """One line; ``job`` is what works on the scan now."""
    first = entry.outcome_words.split()[0]
    plain, fancy = _SIGNS.get("work" if job else first, ("!", "!"))
    cells = {
        "": plain if ascii_only else fancy,
        "name": title_of(entry),
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
        style = _STYLES.get(first, "yellow") if name in ("", "outcome") else ""
        row.append(f"{shorten(cells[name], width - 1):<{width}}", style=style)
    return row


def _outcome(entry: ScanEntry, job: Job | None) -> str:
    if job is None:
        return entry.outcome_words
    return job.title.split()[0] + (f" {100 * job.share:.0f} %" if job.share is not None else " ...")


class ScanDetail(Lines):
    """The chosen scan in full."""

    DEFAULT_CSS = """
    ScanDetail { height: 7; border: round $primary 60%; border-title-color: $text-muted; padding: 0 1; }
    .wide ScanDetail { height: 12; }
    """

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(id="scan-detail", ascii_only=ascii_only)
        self.entry: ScanEntry | None = None
        self.last_words = ""
        """What the last work on it came to."""

    def text_for(self, width: int) -> Text:
        """Lines cut to the pane."""
        if self.entry is None:
            return Text("nothing is chosen", style="dim")
        lines = self.entry.lines()
        text = Text(no_wrap=True)
        if self.last_words:
            text.append(shorten(self.last_words, width) + "\n", style="bold")
        for line in lines:
            text.append(shorten(line, width) + "\n")
        text.right_crop(1)
        return text
