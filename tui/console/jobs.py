"""Long work of the console in child processes of this program: with progress, cancellable, never in the screen's way.

A child prints JSON lines: ``{"done": n, "total": m}`` is progress, any other object a result, plain text what it says.
Everything here belongs to the console's event loop, and so do the callbacks.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from asyncio.subprocess import DEVNULL, PIPE, STDOUT, Process
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from acquire.contract.errors import EXIT_INCOMPLETE
from tui.processes.supervisor import own_command

PROGRAM: Sequence[str] = own_command()
"""What is run with a job's arguments: this program."""
CANCEL_S = 5.0
"""A child that was asked to end may clean up for so long, then it is killed."""
MAX_LINE_BYTES = 8 * 1024 * 1024
"""Longer lines are skipped."""
MAX_JOBS = 4


@dataclass(eq=False)
class Job:
    """State of one job."""

    title: str
    """What it does, for the operator: ``verify 2026...-ear``."""
    subject: str
    """What it works on; a second job on the same subject is refused."""
    quiet: bool = False
    """It only helps a screen: neither its start nor its end is logged, and leaving does not ask about it."""
    started_s: float = field(default_factory=time.monotonic)
    done: int = 0
    total: int = 0
    """0 while that is not known."""
    running: bool = True
    cancelled: bool = False
    exit_status: int | None = None
    result: dict[str, Any] | None = None
    """The last JSON object that it printed."""
    words: str = ""
    """The last plain text that it printed: the reason, if it failed."""
    child: Process | None = None
    """None until it has been started."""

    @property
    def share(self) -> float | None:
        """Progress, 0..1; None where that is not known."""
        return min(1.0, self.done / self.total) if self.total else None

    @property
    def ok(self) -> bool:
        """It ended well; a scan that lacks frames is no failure of the work on it."""
        return self.exit_status in (0, EXIT_INCOMPLETE)

    def end_words(self) -> str:
        """How it ended, in one line; empty while it runs."""
        if self.running:
            return ""
        if self.cancelled:
            return f"{self.title}: cancelled"
        return f"{self.title}: done" if self.ok else f"{self.title}: {self.words or f'exit status {self.exit_status}'}"


OnJobEnd = Callable[[Job], Any]
OnJobResult = Callable[[dict[str, Any]], Any]


class Jobs:
    """Starts jobs, follows them, cancels them."""

    def __init__(
        self,
        say: Callable[[str, str], Any],
        on_change: Callable[[], Any],
        call: Callable[..., Any],
    ) -> None:
        """Args:
        say: logs a text with its level.
        on_change: called when a job started, made progress or ended.
        call: ``call(function, *args)`` calls a callback where its errors are seen (``App.call_later``).
        """
        self._say, self._on_change, self._call = say, on_change, call
        self.environ: dict[str, str] = {}
        """Variables for the children, in addition to the environment of this process."""
        self.running: list[Job] = []
        """The oldest first."""
        self._tasks: set[asyncio.Task[None]] = set()
        self._closed = False

    @property
    def work(self) -> list[Job]:
        """Running jobs that the operator would miss: all but the quiet ones."""
        return [job for job in self.running if not job.quiet]

    def running_on(self, subject: str) -> Job | None:
        """The job that works on ``subject`` now."""
        return next((job for job in self.running if job.subject == subject), None)

    def start(
        self,
        title: str,
        arguments: Sequence[str],
        subject: str,
        on_end: OnJobEnd | None = None,
        *,
        on_result: OnJobResult | None = None,
        quiet: bool = False,
    ) -> Job | None:
        """Run this program with ``arguments``; None, and a line in the log, where that cannot be now.

        ``on_result`` is called with each JSON object, ``on_end`` with the ended job, also while its screen is hidden.
        """
        why_not = self._why_not(subject)
        if why_not:
            self._say(f"{title}: {why_not}", "warning")
            return None
        job = Job(title, subject, quiet)
        self.running.append(job)
        task = asyncio.create_task(self._run(job, arguments, on_end, on_result))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        if not quiet:
            self._say(f"{title}: started", "info")
        return job

    def _why_not(self, subject: str) -> str:
        if self._closed:
            return "the console is closing"
        if self.running_on(subject) is not None:
            return "other work on it runs already; wait, or cancel that"
        return f"{MAX_JOBS} jobs run already; wait, or cancel one" if len(self.running) >= MAX_JOBS else ""

    def cancel(self, job: Job | None) -> None:
        """Ask a job to end and clean up, as Ctrl-C would; it is killed if it does not. Returns at once."""
        if job is None or job.cancelled or not job.running:
            return
        job.cancelled = True
        if job.child is not None:  # otherwise it is interrupted as soon as it has been started
            _interrupt(job.child)
        self._on_change()

    async def close(self) -> None:
        """Cancel all jobs and wait for their ends; nothing can be started afterwards and no callback is called."""
        self._closed = True
        for job in self.running:
            self.cancel(job)
        await asyncio.gather(*self._tasks)

    # ---- the task of one job ----

    async def _run(
        self, job: Job, arguments: Sequence[str], on_end: OnJobEnd | None, on_result: OnJobResult | None
    ) -> None:
        try:
            await self._follow(job, arguments, on_result)
        except OSError as error:
            job.words = str(error)
        job.running = False
        self.running.remove(job)
        self._notify(self._ended, job, on_end)

    def _notify(self, work: Callable[..., Any], *args: Any) -> None:
        if not self._closed:
            self._call(work, *args)

    def _ended(self, job: Job, on_end: OnJobEnd | None) -> None:
        if not job.quiet:
            self._say(job.end_words(), "info" if job.ok else "warning" if job.cancelled else "error")
        if on_end is not None:
            on_end(job)
        self._on_change()

    async def _follow(self, job: Job, arguments: Sequence[str], on_result: OnJobResult | None) -> None:
        job.child = child = await asyncio.create_subprocess_exec(
            *PROGRAM,
            *arguments,
            stdin=DEVNULL,
            stdout=PIPE,
            stderr=STDOUT,
            start_new_session=True,  # Ctrl-C in this terminal must not reach it
            env={**os.environ, "PYTHONUNBUFFERED": "1", **self.environ},
            limit=MAX_LINE_BYTES,
        )
        if job.cancelled:
            _interrupt(child)
        assert child.stdout is not None
        while line := await _next_line(child.stdout):
            self._take(job, line, on_result)
        job.exit_status = await child.wait()

    def _take(self, job: Job, line: bytes, on_result: OnJobResult | None) -> None:
        found = _object(line)
        if found is None:
            job.words = line.decode("utf-8", "replace").strip().removeprefix("sweepscope: ")[:1000] or job.words
        elif set(found) == {"done", "total"}:
            job.done, job.total = _count(found["done"]), _count(found["total"])
        else:
            job.result = found
            if on_result is not None:
                self._notify(on_result, found)
        self._notify(self._on_change)


async def _next_line(lines: asyncio.StreamReader) -> bytes:
    """The next line that is not too long; empty at the end."""
    while True:
        with suppress(ValueError):  # too long: the reader has dropped it
            return await lines.readline()


def _object(line: bytes) -> dict[str, Any] | None:
    if not line.startswith(b"{"):
        return None
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def _count(value: Any) -> int:
    return value if isinstance(value, int) and value >= 0 else 0


def _interrupt(child: Process) -> None:
    """SIGINT now, SIGKILL if that was not enough."""
    _signal(child, signal.SIGINT)
    asyncio.get_running_loop().call_later(CANCEL_S, _signal, child, signal.SIGKILL)


def _signal(child: Process, number: signal.Signals) -> None:
    with suppress(ProcessLookupError):  # it has ended
        child.send_signal(number)
