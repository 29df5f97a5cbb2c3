"""What runs in child processes, one line each with its progress; gone when nothing runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from rich.text import Text

from acquire.contract.units import format_duration
from tui.console.widgets.lines import Lines
from tui.processes.child_jobs import Job
from tui.text.status_text import bar
from tui.text.width import shorten

MOST = 3
BAR_CELLS = 16


class JobLines(Lines):
    """At most three jobs."""

    DEFAULT_CSS = """
    JobLines { height: auto; max-height: 3; padding: 0 2; display: none; }
    JobLines.some { display: block; }
    """

    def __init__(self, *, ascii_only: bool = False, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(id="jobs", ascii_only=ascii_only)
        self._jobs: Sequence[Job] = ()
        self._clock = clock

    def show(self, jobs: Sequence[Job]) -> None:
        """Take what runs."""
        jobs = jobs[:MOST]
        if len(jobs) != len(self._jobs):
            self.refresh(layout=True)
        self._jobs = jobs
        self.set_class(bool(jobs), "some")
        self.changed()

    def text_for(self, width: int) -> Text:
        """One line per job."""
        text = Text(no_wrap=True)
        for number, job in enumerate(self._jobs):
            text.append("\n" if number else "")
            text.append_text(self._line(job, width))
        return text

    def _line(self, job: Job, width: int) -> Text:
        elapsed = format_duration(int(self._clock() - job.started_s))
        share = job.share
        state = "ending" if job.cancelled else f"{100 * share:3.0f} %" if share is not None else "works"
        line = Text(bar(share or 0.0, BAR_CELLS, ascii_only=self.ascii_only), style="#4aa3ff")
        line.append(f" {state:>6}  {elapsed}  ", style="")
        return line.append(shorten(job.title, max(8, width - line.cell_len)), style="bold")
