"""Runs long work of the console in child processes of this program, so that it never blocks the screen.

A child prints lines: ``{"done": n, "total": m}`` is progress, any other JSON object a result, other text a message.
"""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from acquire.contract.errors import EXIT_INCOMPLETE, SweepscopeError
from tui.processes.supervisor import own_command

CANCEL_S = 5.0
"""Time for a cancelled child to clean up, before it is killed."""
MAX_LINE_BYTES = 8 * 1024 * 1024
MAX_JOBS = 4
KEPT = 20
"""Number of ended jobs that are kept in the list."""


@dataclass(frozen=True)
class Job:
    """State of one job."""

    number: int
    title: str
    """For display, such as ``verify 2026...-ear``."""
    subject: str
    """What it works on; a second job on the same subject is refused."""
    started_s: float
    """time.monotonic()."""
    done: int = 0
    total: int = 0
    """0 if not known yet."""
    running: bool = True
    cancelled: bool = False
    exit_status: int | None = None
    result: dict[str, Any] | None = None
    """The last JSON object that it printed, other than progress."""
    words: str = ""
    """The last text that it printed: the reason, if it failed."""

    @property
    def share(self) -> float | None:
        """Progress, 0..1; None if not known."""
        return min(1.0, self.done / self.total) if self.total else None

    @property
    def ok(self) -> bool:
        """It succeeded; an incomplete scan is no failure of the work on it."""
        return self.exit_status in (0, EXIT_INCOMPLETE)

    def end_words(self) -> str:
        """Its result in one line; empty while it runs."""
        if self.running:
            return ""
        if self.cancelled:
            return f"{self.title}: cancelled"
        return f"{self.title}: done" if self.ok else f"{self.title}: {self.words or f'exit status {self.exit_status}'}"


@dataclass
class _Running:
    """The process of a job, and the threads that serve it."""

    child: subprocess.Popen[bytes]
    follower: threading.Thread
    killer: threading.Timer | None = None


class JobBoard:
    """Starts, follows and ends jobs. ``on_change`` is called from other threads: it must be thread-safe."""

    def __init__(self, on_change: Callable[[Job], Any], program: Sequence[str] = ()) -> None:
        """``program``: the command that gets a job's arguments; by default this program."""
        self._on_change = on_change
        self._program = tuple(program) or own_command()
        self.environ: dict[str, str] = {}
        """Variables for the children, in addition to this process' environment."""
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._jobs: dict[int, Job] = {}
        self._running: dict[int, _Running] = {}
        self._closed = False

    @property
    def jobs(self) -> list[Job]:
        """Running and recent jobs, the newest last."""
        with self._lock:
            return list(self._jobs.values())

    def running_on(self, subject: str) -> Job | None:
        """The running job that works on ``subject``."""
        return next((job for job in self.jobs if job.running and job.subject == subject), None)

    def start(
        self,
        title: str,
        arguments: Sequence[str],
        subject: str,
        on_result: Callable[[dict[str, Any]], Any] = lambda _: None,
    ) -> Job:
        """Run this program with ``arguments``; ``on_result`` is called for each result, from the job's thread.

        Raises:
            SweepscopeError: a job works on the subject already, or too many run.
        """
        if self.running_on(subject) is not None:
            raise SweepscopeError(f"{title}: other work on it runs already; wait, or cancel that")
        if sum(job.running for job in self.jobs) >= MAX_JOBS or self._closed:
            raise SweepscopeError(f"{title}: {MAX_JOBS} jobs run already; wait, or cancel one")
        child = subprocess.Popen(
            [*self._program, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C in this terminal must not reach it
            env={**os.environ, "PYTHONUNBUFFERED": "1", **self.environ},
        )
        job = Job(next(self._numbers), title, subject, time.monotonic())
        follower = threading.Thread(
            target=self._follow, args=(job.number, child, on_result), name=f"job-{job.number}", daemon=True
        )
        with self._lock:
            self._jobs[job.number], self._running[job.number] = job, _Running(child, follower)
            self._forget_old()
        follower.start()
        self._on_change(job)
        return job

    def cancel(self, number: int) -> None:
        """Interrupt a job, so that it cleans up; kill it after :data:`CANCEL_S`. Returns at once."""
        running = self._running.get(number)
        if running is not None and running.child.poll() is None:
            self._change(number, cancelled=True)
            running.child.send_signal(signal.SIGINT)
            running.killer = threading.Timer(CANCEL_S, running.child.kill)
            running.killer.daemon = True
            running.killer.start()

    def close(self) -> None:
        """Interrupt all jobs and wait for them, at most :data:`CANCEL_S` and a little."""
        self._closed = True
        for running in self._running.values():
            running.child.send_signal(signal.SIGINT)
        deadline_s = time.monotonic() + CANCEL_S
        for running in self._running.values():
            try:
                running.child.wait(max(0.0, deadline_s - time.monotonic()))
            except subprocess.TimeoutExpired:
                running.child.kill()
        for running in self._running.values():
            running.follower.join(1.0)

    # ---- a job's thread ----

    def _follow(self, number: int, child: subprocess.Popen[bytes], on_result: Callable[[dict[str, Any]], Any]) -> None:
        assert child.stdout is not None
        with child.stdout as lines:
            while line := lines.readline(MAX_LINE_BYTES):  # a longer line arrives in pieces
                self._take_line(number, line, on_result)
        status = child.wait()
        if killer := self._running[number].killer:
            killer.cancel()
        self._change(number, running=False, exit_status=status)

    def _take_line(self, number: int, line: bytes, on_result: Callable[[dict[str, Any]], Any]) -> None:
        found = _object(line)
        if found is None:
            words = line.decode("utf-8", "replace").strip().removeprefix("sweepscope: ")
            if words:
                self._change(number, words=words[:1000])
        elif set(found) == {"done", "total"}:
            self._change(number, done=_count(found["done"]), total=_count(found["total"]))
        else:
            self._change(number, result=found)
            on_result(found)

    def _change(self, number: int, **changes: Any) -> None:
        with self._lock:
            job = replace(self._jobs[number], **changes)
            self._jobs[number] = job
        self._on_change(job)

    def _forget_old(self) -> None:
        ended = [number for number, job in self._jobs.items() if not job.running]
        for number in ended[:-KEPT]:
            del self._jobs[number], self._running[number]


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
