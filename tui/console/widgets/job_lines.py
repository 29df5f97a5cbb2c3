"""Running child processes with their progress, one line each; hidden while nothing runs."""

from __future__ import annotations

import time
from collections.abc import Sequence

from rich.text import Text

from acquire.contract.units import format_duration
from tui.console.jobs import Job
from tui.console.widgets.lines import Lines
from tui.text.status_text import bar
from tui.text.width import shorten

MAX_LINES = 3
BAR_CELLS = 16


class JobLines(Lines[Sequence[Job]]):
    """At most three jobs."""

    DEFAULT_CSS = """
    JobLines { height: auto; max-height: 3; padding: 0 2; display: none; }
    JobLines.some { display: block; }
    """

    def show(self, value: Sequence[Job]) -> None:
        """Take the running jobs."""
        jobs = value[:MAX_LINES]
        if len(jobs) != len(self.shown):
            self.refresh(layout=True)
        self.set_class(bool(jobs), "some")
        super().show(jobs)

    def text_for(self, width: int) -> Text:
        """One line per job."""
        return Text("\n", no_wrap=True).join(_line(job, width) for job in self.shown)


def _line(job: Job, width: int) -> Text:
    share = job.share
    state = "ending" if job.cancelled else f"{100 * share:3.0f} %" if share is not None else "working"
    line = Text(bar(share or 0.0, BAR_CELLS), style="#4aa3ff")
    line.append(f" {state:>7}  {format_duration(int(time.monotonic() - job.started_s))}  ", style="")
    return line.append(shorten(job.title, max(8, width - line.cell_len)), style="bold")
