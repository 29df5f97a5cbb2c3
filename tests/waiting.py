"""Waits of the tests, with deadlines that tell a hang from a busy machine.

Beside eight programs that compute, a process gets a fifth of a core or less, and a deadline by the wall clock fails
though nothing hangs. So deadlines of tests count seconds of an undisturbed machine: a second counts as the share of
the time that our processes got of what they asked for. Linux tells it: how long each thread has run, and how long it
has waited for a core. A hang does not ask for a core and reaches its deadline in time; what computes on a busy machine
gets as many seconds as it loses.

All waits of tests go through this module, and the time limit of each test (``conftest.py``) uses the same clock.
"""

from __future__ import annotations

import os
import queue
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import psutil

DEADLINE_S = 60.0
"""After so many seconds of an undisturbed machine a wait is a hang."""

WALL_CLOCK_S = 600.0
"""For calls that take only a time-out by the wall clock: the time limit of the test ends a hang much earlier."""

_SAMPLE_S = 0.5
_SLICE_S = 0.2
_LEAST_SHARE = 0.01
"""So that every deadline ends some time."""
_NS_PER_S = 1_000_000_000

T = TypeVar("T")


def fair_share(runnable: int, cores: int) -> float:
    """Share of a core for each of ``runnable`` threads on ``cores``; 1.0 while there is a core for each."""
    return min(1.0, cores / max(1, runnable))


def share_got(ran_s: float, waited_s: float, wall_s: float) -> float:
    """Share of ``wall_s`` that processes which ran and waited for a core so long were not kept waiting.

    One that computes all the time gets ran / (ran + waited); one that rests most of the time loses what it waited.
    """
    if waited_s <= 0:
        return 1.0
    return 1.0 - min(waited_s / (ran_s + waited_s), waited_s / wall_s)


class MachineShare:
    """How much of an undisturbed machine the processes of this test run got since the last question.

    The smaller of two measures: what their threads waited for a core, which is exact but misses processes that have
    left this process's family (a terminal's server), and the fair share of a core for each thread of the machine.
    """

    def __init__(self) -> None:
        self._cores = len(os.sched_getaffinity(0))
        self._before = _thread_times()

    def __call__(self, wall_s: float) -> float:
        now, ran_ns, waited_ns = _thread_times(), 0, 0
        for thread, (ran, waited) in now.items():
            ran_before, waited_before = self._before.get(thread, (0, 0))
            ran_ns, waited_ns = ran_ns + ran - ran_before, waited_ns + waited - waited_before
        self._before = now
        got = share_got(ran_ns / _NS_PER_S, waited_ns / _NS_PER_S, wall_s)
        return max(_LEAST_SHARE, min(got, fair_share(_runnable(), self._cores)))


def _thread_times() -> dict[str, tuple[int, int]]:
    """For each thread of this process and its descendants: ns that it ran, ns that it waited for a core."""
    me, times = psutil.Process(), {}
    for process in [me, *me.children(recursive=True)]:
        with suppress(OSError):  # the process has ended
            for task in Path(f"/proc/{process.pid}/task").iterdir():
                with suppress(OSError):  # the thread has ended
                    ran, waited, _ = map(int, (task / "schedstat").read_text().split())
                    times[str(task)] = ran, waited
    return times


def _runnable() -> int:
    """Threads of the whole machine that run or wait for a core, without the one that asks."""
    return int(Path("/proc/loadavg").read_text().split()[3].split("/")[0]) - 1


class UndisturbedClock:
    """Counts the seconds of an undisturbed machine; a thread of its own samples the load twice a second.

    Args:
        share: given the seconds since the last sample, the share of them that counts.
    """

    def __init__(self, share: Callable[[float], float]) -> None:
        self._ask = share
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
        """Count the time since the last sample."""
        wall_s = time.monotonic() - self._at_s
        share = self._ask(wall_s)
        with self._lock:
            self._share, self._at_s = share, self._at_s + wall_s
            self._elapsed_s += wall_s * share

    def _sample_forever(self) -> None:
        while True:
            time.sleep(_SAMPLE_S)
            self.sample()


CLOCK = UndisturbedClock(MachineShare())


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
