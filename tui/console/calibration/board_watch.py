"""The child that looks for the board in the preview: runs while it is wanted, and what it said is kept.

A child that ended by itself is not started again at once, and its last words stand until the next one speaks.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from tui.console.job_runner import JobDesk
from tui.processes.child_jobs import Job

SUBJECT = "board"
AGAIN_S, CANCELLED_S = 5.0, 0.5
"""A child that ended by itself, or was asked to, is not started again before."""


class BoardWatch:
    """At most one child; ``on_facts`` is called from its thread with each object that it prints."""

    def __init__(self, jobs: Callable[[], JobDesk], on_facts: Callable[[dict[str, Any]], Any]) -> None:
        """``jobs``: the desk of the console, asked for when it is needed."""
        self._jobs, self._on_facts = jobs, on_facts
        self._child: Job | None = None
        self._again_s = 0.0
        self._words = ""
        self.facts: dict[str, Any] = {}
        """The newest that is known: views, coverage, advice, the board as it lies (``live``)."""

    def follow(self, command: Sequence[str], *, wanted: bool) -> None:
        """Start the child where it is wanted and none runs, or end it."""
        if not wanted:
            self.stop()
        elif self._child is None and time.monotonic() >= self._again_s:
            self._words = ""
            self._child = self._jobs().start(
                "look for the board", command, SUBJECT, self._ended, on_result=self._on_facts, quiet=True
            )
            if self._child is None:
                self._again_s = time.monotonic() + AGAIN_S  # why was said; not again at each repaint

    def stop(self) -> None:
        """Nobody looks: nothing is looked for."""
        if self._child is not None:
            self._jobs().cancel(self._child)
            self._child, self._again_s = None, time.monotonic() + CANCELLED_S

    def begin_anew(self) -> None:
        """What was seen so far is of another board, or other views."""
        self.facts = {}
        self.stop()

    def take(self, facts: dict[str, Any]) -> None:
        """What the child found; where it looked at the views only, the board lies as before."""
        self.facts = {**facts, "live": facts.get("live") or self.facts.get("live")}

    @property
    def live(self) -> dict[str, Any]:
        """The board as it lies now; empty while that is not known."""
        return self.facts.get("live") or {}

    def words(self, *, wanted: bool) -> str:
        """How the board lies, or why that is not known."""
        waiting = "looking for the board ..." if wanted and not self.facts else ""
        return self._words or str(self.live.get("words") or "") or waiting

    def _ended(self, job: Job) -> None:
        if self._child is not None and self._child.number == job.number:
            self._child = None
        if not job.cancelled:
            self._again_s, self._words = time.monotonic() + AGAIN_S, job.words
