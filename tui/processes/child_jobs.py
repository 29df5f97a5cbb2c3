"""Long work of the console as child processes of this program: never in the screen's way, cancellable, accounted for.

A child prints JSON lines: ``{"done": n, "total": m}`` is progress, any other object a result, plain text what it says.
"""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import IO, Any

from acquire.contract.errors import EXIT_INCOMPLETE, SweepscopeError

CANCEL_S = 5.0
"""A child that was asked to end cleans up within so long, or is killed."""
MAX_LINE_BYTES = 8 * 1024 * 1024
MAX_JOBS = 4
KEPT = 20
"""Ended jobs that are remembered."""


@dataclass(frozen=True)
class Job:
    """One piece of work as it stands."""

    number: int
    title: str
    """What it does, for people: ``verify 2026...-ear``."""
    subject: str
    """What it works on; two jobs on the same subject are refused."""
    started_s: float
    """time.monotonic()."""
    done: int = 0
    total: int = 0
    """0 while that is not known."""
    running: bool = True
    cancelled: bool = False
    exit_status: int | None = None
    result: dict[str, Any] | None = None
    """The last object that it printed."""
    words: str = ""
    """The last plain text that it printed: the reason, if it failed."""

    @property
    def share(self) -> float | None:
        """How far it is, 0..1; None where that is not known."""
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


class JobBoard:
    """Starts jobs, follows them, ends them. Changes are told from threads: the callback must be safe for that."""

    def __init__(self, on_change: Callable[[Job], Any], program: Sequence[str] = ()) -> None:
        """``program``: what is run with a job's arguments; by default this program."""
        self._on_change = on_change
        self._program = list(program) or [sys.executable, "-m", "tui.cli"]
        self.environ: dict[str, str] = {}
        """What children are told beside this process' own environment."""
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._jobs: dict[int, Job] = {}
        self._children: dict[int, subprocess.Popen[bytes]] = {}
        self._threads: dict[int, threading.Thread] = {}
        self._killers: dict[int, threading.Timer] = {}
        self._closed = False

    @property
    def jobs(self) -> list[Job]:
        """All jobs that are remembered, the newest last."""
        with self._lock:
            return list(self._jobs.values())

    def running_on(self, subject: str) -> Job | None:
        """The job that works on ``subject`` now."""
        return next((job for job in self.jobs if job.running and job.subject == subject), None)

    def start(
        self,
        title: str,
        arguments: Sequence[str],
        subject: str,
        on_result: Callable[[dict[str, Any]], Any] = lambda _: None,
    ) -> Job:
        """Run this program with ``arguments``; ``on_result`` is called for each object, from the job's thread.

        Raises:
            SweepscopeError: something works on the subject already, or too much runs.
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
            start_new_session=True,  # Ctrl-C in this terminal is not meant for it
            env={**os.environ, "PYTHONUNBUFFERED": "1", **self.environ},
        )
        job = Job(next(self._numbers), title, subject, time.monotonic())
        thread = threading.Thread(target=self._follow, args=(job.number, child, on_result), name=f"job-{job.number}")
        thread.daemon = True
        with self._lock:
            self._jobs[job.number], self._children[job.number], self._threads[job.number] = job, child, thread
            self._forget_old()
        thread.start()
        self._on_change(job)
        return job

    def cancel(self, number: int) -> None:
        """Ask a job to end and clean up; it is killed if it does not. Returns at once."""
        child = self._children.get(number)
        if child is not None and child.poll() is None:
            self._change(number, cancelled=True)
            _interrupt(child)
            killer = threading.Timer(CANCEL_S, _kill, [child])
            killer.daemon = True
            self._killers[number] = killer
            killer.start()

    def close(self) -> None:
        """End all jobs and wait for them; at most :data:`CANCEL_S` and a little."""
        self._closed = True
        running = [child for child in self._children.values() if child.poll() is None]
        for child in running:
            _interrupt(child)
        deadline_s = time.monotonic() + CANCEL_S
        for child in running:
            try:
                child.wait(max(0.0, deadline_s - time.monotonic()))
            except subprocess.TimeoutExpired:
                _kill(child)
        for thread in self._threads.values():
            thread.join(1.0)

    # ---- a job's thread ----

    def _follow(self, number: int, child: subprocess.Popen[bytes], on_result: Callable[[dict[str, Any]], Any]) -> None:
        assert child.stdout is not None
        with child.stdout as lines:
            while line := _line(lines):
                self._hear(number, line, on_result)
        status = child.wait()
        if killer := self._killers.pop(number, None):
            killer.cancel()
        self._change(number, running=False, exit_status=status)

    def _hear(self, number: int, line: bytes, on_result: Callable[[dict[str, Any]], Any]) -> None:
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
            for table in (self._jobs, self._children, self._threads):
                table.pop(number, None)


def _line(lines: IO[bytes]) -> bytes:
    """The next line; what is longer than any line of ours is passed over in pieces."""
    return lines.readline(MAX_LINE_BYTES)


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


def _interrupt(child: subprocess.Popen[bytes]) -> None:
    """As Ctrl-C would: the child cleans up after itself."""
    if child.poll() is None:
        child.send_signal(signal.SIGINT)


def _kill(child: subprocess.Popen[bytes]) -> None:
    if child.poll() is None:
        child.kill()
