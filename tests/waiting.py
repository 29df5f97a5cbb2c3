"""Waits of the tests, with deadlines that tell a hang from a busy machine.

Beside eight programs that compute, a process gets a fifth of a core, and a deadline by the wall clock fails though
nothing hangs. So deadlines of tests count seconds of an undisturbed machine: while more threads want a core than
there are cores, a second counts as the share of a core that each thread gets. A deadline of 30 s is 30 s on an idle
machine and 150 s beside a load of eight on two cores; a hang reaches it on both.

All waits of tests go through this module, and the time limit of each test (``conftest.py``) uses the same clock.
"""

from __future__ import annotations

import os
import queue
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import psutil

DEADLINE_S = 60.0
"""After so many seconds of an undisturbed machine a wait is a hang."""

WALL_CLOCK_S = 600.0
"""For calls that take only a time-out by the wall clock: the time limit of the test ends a hang much earlier."""

_SAMPLE_S = 0.1
_SLICE_S = 0.2
_LOAD = Path("/proc/loadavg")

T = TypeVar("T")


def share_of_a_core(runnable: int, cores: int) -> float:
    """Share of a core that each of ``runnable`` threads gets on ``cores``; 1.0 while there is a core for each."""
    return min(1.0, cores / max(1, runnable))


def runnable_threads() -> int:
    """Threads of the whole machine that run or wait for a core, without the one that asks; 0 where Linux hides it."""
    try:
        return int(_LOAD.read_text().split()[3].split("/")[0]) - 1
    except OSError:
        return 0


class UndisturbedClock:
    """Counts the seconds of an undisturbed machine; a thread of its own samples the load ten times a second."""

    def __init__(self, runnable: Callable[[], int] = runnable_threads) -> None:
        self._runnable = runnable
        self._cores = len(os.sched_getaffinity(0))
        self._lock = threading.Lock()
        self._sampler: threading.Thread | None = None
        self._elapsed_s, self._share, self._at_s = 0.0, 1.0, time.monotonic()

    def now_s(self) -> float:
        """Seconds since some moment in the past; may step back by less than a sample."""
        with self._lock:
            if self._sampler is None:
                self._sampler = threading.Thread(target=self._sample_forever, name="undisturbed-clock", daemon=True)
                self._sampler.start()
            return self._elapsed_s + (time.monotonic() - self._at_s) * self._share

    def sample(self) -> None:
        """Count the time since the last sample by the load of this moment."""
        with self._lock:
            now_s, self._share = time.monotonic(), share_of_a_core(self._runnable(), self._cores)
            self._elapsed_s += (now_s - self._at_s) * self._share
            self._at_s = now_s

    def _sample_forever(self) -> None:
        while True:
            time.sleep(_SAMPLE_S)
            self.sample()


CLOCK = UndisturbedClock()


class Stopwatch:
    """Seconds of an undisturbed machine since it was made."""

    def __init__(self) -> None:
        self._begin_s = CLOCK.now_s()

    @property
    def elapsed_s(self) -> float:
        return CLOCK.now_s() - self._begin_s


def wait_for(
    fact: Callable[[], T],
    what: str,
    deadline_s: float = DEADLINE_S,
    *,
    pause: Callable[[], object] = lambda: time.sleep(0.005),
    why: Callable[[], object] = str,
) -> T:
    """Ask until ``fact`` is true and return it; AssertionError says ``what`` did not come, and ``why`` if it knows."""
    watch = Stopwatch()
    while not (found := fact()):
        if watch.elapsed_s > deadline_s:
            raise AssertionError(f"not within {deadline_s:g} s of an undisturbed machine: {what}\n{why()}".rstrip())
        pause()
    return found


def next_of(events: queue.Queue[T], deadline_s: float = DEADLINE_S, what: str = "an event") -> T:
    """The next entry of a queue."""
    found: list[T] = []

    def came() -> bool:
        try:
            found.append(events.get(timeout=_SLICE_S))
        except queue.Empty:
            return False
        return True

    wait_for(came, what, deadline_s, pause=str)
    return found[0]


def exit_status(process: subprocess.Popen[Any], deadline_s: float = DEADLINE_S) -> int:
    """Wait for the end of a process; its exit status."""
    wait_for(lambda: process.poll() is not None, f"the end of {process.args!r}", deadline_s)
    return process.returncode


def output_of(process: subprocess.Popen[str], deadline_s: float = DEADLINE_S) -> tuple[str, str]:
    """Read what a process writes until its end: stdout and stderr. One that hangs is killed."""
    watch = Stopwatch()
    while True:
        try:
            return process.communicate(timeout=_SLICE_S)
        except subprocess.TimeoutExpired:
            if watch.elapsed_s <= deadline_s:
                continue
            process.kill()
            said = process.communicate()
            raise AssertionError(f"{process.args!r} did not end within {deadline_s:g} s: {said}") from None


def run(
    command: Sequence[str | Path], deadline_s: float = DEADLINE_S, *, check: bool = False, **options: Any
) -> subprocess.CompletedProcess[str]:
    """As subprocess.run with captured text."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **{**pipes, **options}) as process:
        done = subprocess.CompletedProcess(command, 0, *output_of(process, deadline_s))
        done.returncode = process.returncode
    if check:
        done.check_returncode()
    return done


def still_alive(processes: Iterable[psutil.Process], deadline_s: float = DEADLINE_S) -> list[psutil.Process]:
    """Processes that are not gone when the deadline has passed."""
    watch, alive = Stopwatch(), list(processes)
    while alive and watch.elapsed_s <= deadline_s:
        _, alive = psutil.wait_procs(alive, timeout=_SLICE_S)
    return alive
