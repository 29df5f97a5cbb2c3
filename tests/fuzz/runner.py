"""Runs cases, each in a fork of this process or in an interpreter of its own, and judges how they end."""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import pty
import re
import resource
import select
import signal
import sys
import time
from collections.abc import Mapping, Set
from dataclasses import dataclass
from pathlib import Path

import psutil

from tests import ROOT
from tests.fuzz.cases import Case

DOCUMENTED = frozenset({0, 1, 2, 3, 4, 130, 141})
MOST_WALL_S = 60.0
MOST_CPU_S = 10.0
HANG_UP_S = 12.0
"""A terminal at which a command still waits hangs up."""
SERVICE_S = 3.0
"""A service that runs is told to end after this time."""
_PR_SET_CHILD_SUBREAPER = 36
_SPOKEN = re.compile(r"^sweepscope(?: up| demo)?: ", re.MULTILINE)
_OWN_WORDS = ("doctor", "verify", "check", "logs", "recover", "up", "demo", "response", "--configured")
"""Commands whose result may be a failure that they print themselves."""


@dataclass(frozen=True)
class End:
    """How a case ended."""

    status: int
    """Exit status; negative: killed by that signal."""
    out: str
    err: str
    cpu_s: float
    wall_s: float
    told_to_end: bool


def judge(case: Case, end: End, *, may_be_slow: bool = False) -> str:
    """What is wrong with this end; empty: nothing. ``may_be_slow``: kernels were compiled meanwhile."""
    said = end.out + end.err
    allowed = DOCUMENTED | ({128 + signal.SIGTERM, -signal.SIGTERM} if end.told_to_end else frozenset())
    if "(a bug" in said:
        return "a bug"
    if "Traceback" in said or "Exception ignored" in said:
        return "a traceback"
    if end.status not in allowed:
        return f"status {end.status}"
    lines = len(_SPOKEN.findall(end.err))
    failed = end.status in (1, 2, 3) and case.streams not in ("closed", "terminal", "dumb")
    if failed and lines != 1 and not set(_OWN_WORDS).intersection(case.arguments):
        return f"{lines} sentences"
    slow = end.cpu_s > MOST_CPU_S or end.wall_s > MOST_WALL_S
    if slow and said.count("\n") < 3 and not end.told_to_end and not may_be_slow:
        return f"silent for {end.cpu_s:.0f} s of processor time, {end.wall_s:.0f} s in all"
    return ""


def told(case: Case, end: End, wrong: str) -> str:
    """What was run and how it ended, for a person."""
    lines = [
        f"--- case {case.number}: {wrong or 'good'} (status {end.status}, {end.cpu_s:.1f} s)",
        f"    {ascii(' '.join(case.arguments))[:600]}",
        f"    {ascii(case.environ)[:300]} {case.streams} {case.encoding} {'own' if case.own_interpreter else ''}",
    ]
    return "\n".join(
        lines + [f"    | {ascii(line)[:300]}" for text in (end.out, end.err) for line in text.splitlines()[-6:]]
    )


def run(case: Case, folder: Path, live_dir: Path) -> End:
    """Run one case in ``folder``; ``live_dir``: the run directory of a daemon."""
    out, err = (folder / f".{name}" for name in ("out", "err"))
    began_s, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    ends = _Streams(case.streams, out, err)
    pid = os.fork()
    if pid == 0:
        _child(case, folder, ends, live_dir)
    ends.close_ours()
    status, told = _wait(pid, case, ends)
    ends.finish()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    texts = [path.read_bytes().decode("utf-8", "replace") if path.exists() else "" for path in (out, err)]
    return End(status, texts[0] + ends.painted, texts[1], cpu_s, time.monotonic() - began_s, told)


class _Streams:
    """stdin, stdout and stderr of a case."""

    def __init__(self, kind: str, out: Path, err: Path) -> None:
        self.kind, self.painted = kind, ""
        self._master = -1
        out.write_bytes(b"")
        err.write_bytes(b"")
        null = os.open(os.devnull, os.O_RDWR)
        self.fds = [null, os.open(out, os.O_WRONLY | os.O_APPEND), os.open(err, os.O_WRONLY | os.O_APPEND)]
        if kind in ("terminal", "dumb"):
            self._master, slave = pty.openpty()
            self.fds = [slave] * 3
        elif kind == "full":
            self.fds[1] = os.open("/dev/full", os.O_WRONLY)
        elif kind == "reader gone":
            read_end, self.fds[1] = os.pipe()
            os.close(read_end)

    def install(self) -> None:
        """In the child: make them 0, 1 and 2."""
        for number, fd in enumerate(self.fds):
            os.dup2(fd, number)
        if self.kind == "closed":
            os.close(0)
            os.close(1)

    def close_ours(self) -> None:
        for fd in set(self.fds):
            os.close(fd)

    def read(self) -> None:
        """Take what was painted on the terminal, and answer nothing."""
        while self._master >= 0 and select.select([self._master], [], [], 0)[0]:
            try:
                data = os.read(self._master, 65_536)
            except OSError:
                return
            if not data:
                return
            self.painted = (self.painted + data.decode("utf-8", "replace"))[-20_000:]

    def hang_up(self) -> None:
        """Close the terminal; idempotent."""
        if self._master >= 0:
            os.close(self._master)
        self._master = -1

    def finish(self) -> None:
        self.read()
        self.hang_up()


def _wait(pid: int, case: Case, ends: _Streams) -> tuple[int, bool]:
    began_s, told = time.monotonic(), False
    while True:
        found, status = os.waitpid(pid, os.WNOHANG)
        ends.read()
        if found:
            return os.waitstatus_to_exitcode(status), told
        waited_s = time.monotonic() - began_s
        if waited_s > MOST_WALL_S + (20.0 if told else 0.0):
            os.killpg(pid, signal.SIGKILL)
        elif case.streams in ("terminal", "dumb") and waited_s > HANG_UP_S and not case.is_service:
            ends.hang_up()
        elif case.is_service and waited_s > SERVICE_S and not told:
            told = True
            os.kill(pid, signal.SIGTERM)
        time.sleep(0.01)


def surroundings(case: Case, folder: Path) -> dict[str, str]:
    """The environment of a case."""
    kept = {name: os.environ[name] for name in ("PATH", "NUMBA_CACHE_DIR") if name in os.environ}
    base = {"HOME": str(folder / "home"), "SWEEPSCOPE_RUN": str(folder / "run"), "SWEEPSCOPE_VIEWER__PORT": "0"}
    term = {"dumb": "dumb", "terminal": "xterm-256color"}.get(case.streams, "")
    return {**kept, "PYTHONPATH": str(ROOT), "LANG": "C.UTF-8", "TERM": term, **base, **case.environ}


def _child(case: Case, folder: Path, ends: _Streams, live_dir: Path) -> None:
    """Never returns."""
    status = 99
    try:
        os.setsid()
        environ = surroundings(case, folder)
        if case.live:
            environ["SWEEPSCOPE_RUN"] = str(live_dir)
        ends.install()
        os.chdir(folder)
        if case.own_interpreter:
            os.execve(sys.executable, [sys.executable, "-m", "tui.cli", *case.arguments], environ)
        status = _run_here(case, environ)
    except BaseException:  # noqa: BLE001 - the judge reads it
        import traceback

        os.write(2, traceback.format_exc().encode(errors="replace"))
    finally:
        os._exit(status & 0xFF)


def _run_here(case: Case, environ: Mapping[str, str]) -> int:
    from tui import cli
    from tui.text.streams import prepare_streams

    os.environ.clear()
    os.environ.update(environ)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    is_open = case.streams != "closed"
    sys.stdin = os.fdopen(0, "r", encoding=case.encoding) if is_open else None  # type: ignore[assignment]
    sys.stdout = _writer(1, case.encoding) if is_open else None  # type: ignore[assignment]
    sys.stderr = _writer(2, case.encoding)
    sys.__stdin__, sys.__stdout__, sys.__stderr__ = sys.stdin, sys.stdout, sys.stderr  # type: ignore[misc]
    prepare_streams()
    status = cli.run(case.arguments)
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    return status


def _writer(fd: int, encoding: str) -> io.TextIOWrapper:
    return io.TextIOWrapper(os.fdopen(fd, "wb", buffering=0), encoding=encoding, write_through=True)


def prepare() -> None:
    """Load what the commands load, so that a fork begins at once."""
    from acquire.daemon import service  # noqa: F401
    from acquire.writer import service as writer  # noqa: F401
    from process.results import reconstruct  # noqa: F401
    from process.viewer import service as viewer  # noqa: F401
    from process.worker import service as worker  # noqa: F401
    from tui.console import run  # noqa: F401
    from tui.demo import run as demo  # noqa: F401


def end_leftovers(kept: Set[int]) -> None:
    """End what a case has started and left (orphans come to this process), but for the processes ``kept``."""
    left = [child for child in psutil.Process().children(recursive=True) if child.pid not in kept]
    for child in left:
        with contextlib.suppress(psutil.NoSuchProcess):
            child.kill()
    psutil.wait_procs(left, timeout=5)


def adopt_orphans() -> None:
    """Make this process the parent of every process whose own parent ends."""
    if ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0):
        raise OSError(ctypes.get_errno(), "prctl")
