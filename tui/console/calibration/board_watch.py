"""The child process that looks for the board in the preview: started and stopped on demand, its newest report kept.

A child that ended by itself is not started again at once, and its last words are shown until the next one reports.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from tui.console.jobs import Job, Jobs

SUBJECT = "board"
AGAIN_S, CANCELLED_S = 5.0, 0.5
"""Delay before the next start after a child ended by itself, or was cancelled."""


class BoardWatch:
    """At most one child; ``on_change`` is called after each of its reports."""

    def __init__(self, jobs: Jobs, on_change: Callable[[], Any]) -> None:
        self._jobs, self._on_change = jobs, on_change
        self._child: Job | None = None
        self._again_s = 0.0
        self._words = ""
        self.facts: dict[str, Any] = {}
        """The newest report: views, coverage, advice, the board as it lies (``live``)."""

    def follow(self, command: Sequence[str], *, wanted: bool) -> None:
        """Start the child if it is wanted and does not run, or cancel it."""
        if not wanted:
            self.stop()
        elif self._child is None and time.monotonic() >= self._again_s:
            self._words = ""
            self._child = self._jobs.start(
                "look for the board", command, SUBJECT, self._ended, on_result=self._take, quiet=True
            )
            if self._child is None:
                self._again_s = time.monotonic() + AGAIN_S  # the reason was logged; not again with each repaint

    def stop(self) -> None:
        """Cancel the child."""
        if self._child is not None:
            self._jobs.cancel(self._child)
            self._child, self._again_s = None, time.monotonic() + CANCELLED_S

    def begin_anew(self) -> None:
        """Drop what is known: it is of another board, or of other views."""
        self.facts = {}
        self.stop()

    def _take(self, facts: dict[str, Any]) -> None:
        # a report on the views alone has no ``live``: the board lies as before
        self.facts = {**facts, "live": facts.get("live") or self.facts.get("live")}
        self._on_change()

    @property
    def live(self) -> dict[str, Any]:
        """The board as it lies now; empty while that is not known."""
        return self.facts.get("live") or {}

    def words(self, *, wanted: bool) -> str:
        """How the board lies, or why that is not known."""
        waiting = "looking for the board ..." if wanted and not self.facts else ""
        return self._words or str(self.live.get("words") or "") or waiting

    def _ended(self, job: Job) -> None:
        if job is self._child:
            self._child = None
        if not job.cancelled:
            self._again_s, self._words = time.monotonic() + AGAIN_S, job.words
