"""Keeps child processes running: starts and restarts them, ends them all in order, leaves no orphan."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from acquire.contract.errors import EXIT_FAILED
from tui.processes.parent_watch import LIFELINE_VARIABLE

FIRST_BACK_OFF_S = 0.2
LONGEST_BACK_OFF_S = 5.0
HEALTHY_S = 10.0
"""A child that ran so long is restarted with the shortest back-off."""
HOPELESS_STARTS = 5
"""A child that died so often in a row, each time before HEALTHY_S, is given up."""
POLL_S = 0.05


@dataclass(frozen=True)
class ServiceSpec:
    """Name and command line of a child."""

    name: str
    argv: tuple[str, ...]


def own_command(*arguments: str, config_path: str | None = None) -> tuple[str, ...]:
    """The command line that runs ``sweepscope ARGUMENTS`` with this interpreter."""
    config = ("--config", config_path) if config_path else ()
    return (sys.executable, "-m", "tui.cli", *config, *arguments)


@dataclass
class _Child:
    spec: ServiceSpec
    process: subprocess.Popen[bytes] | None = None
    started_s: float = 0.0
    restart_at_s: float | None = None
    deaths_in_a_row: int = 0
    restarts: int = 0
    given_up: bool = False


@dataclass
class Supervisor:
    """A set of children. One thread calls all methods, and :meth:`tend` several times a second."""

    specs: Sequence[ServiceSpec]
    """In the order of starting; the first is ended first and alone, so that the others serve it until then."""
    environ: Mapping[str, str]
    say: Callable[[str], None]
    """Called with one line for every death and restart."""
    log_dir: Path | None = None
    """Folder for the children's output, one file each; None: our own streams."""
    final_refusals: frozenset[str] = frozenset()
    """Children that are given up when their first start ends with EXIT_FAILED: they have said what is missing."""
    clock_s: Callable[[], float] = time.monotonic
    _children: list[_Child] = field(default_factory=list)
    _lifeline: tuple[int, int] | None = None

    def start(self) -> None:
        """Start every child."""
        self._lifeline = os.pipe()
        self._children = [_Child(spec) for spec in self.specs]
        for child in self._children:
            self._launch(child)

    def tend(self) -> None:
        """Detect deaths, and restart the children whose back-off is over."""
        for child in self._children:
            if child.process is not None and child.process.poll() is not None:
                self._handle_death(child, child.process.returncode)
            elif child.restart_at_s is not None and self.clock_s() >= child.restart_at_s:
                child.restarts += 1
                self._launch(child)

    @property
    def given_up(self) -> list[str]:
        """Names of the children that could not be kept alive."""
        return [child.spec.name for child in self._children if child.given_up]

    @property
    def restarts(self) -> dict[str, int]:
        """Number of restarts of each child."""
        return {child.spec.name: child.restarts for child in self._children}

    @property
    def pids(self) -> dict[str, int]:
        """Process ids of the running children."""
        return {child.spec.name: child.process.pid for child in self._children if child.process is not None}

    def stop(self, deadline_s: float) -> None:
        """End the first child, then the others: SIGTERM, and SIGKILL after ``deadline_s``."""
        for child in self._children:
            child.restart_at_s = None
        for group in (self._children[:1], self._children[1:]):
            self._end(group, deadline_s)
        if self._lifeline is not None:
            for descriptor in self._lifeline:
                os.close(descriptor)
            self._lifeline = None

    def _launch(self, child: _Child) -> None:
        assert self._lifeline is not None
        read_end = self._lifeline[0]
        output = self._output(child.spec.name)
        try:
            child.process = subprocess.Popen(
                child.spec.argv,
                env={**self.environ, LIFELINE_VARIABLE: str(read_end)},
                pass_fds=(read_end,),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT if output else None,
                start_new_session=True,  # Ctrl-C in the terminal reaches only us, and we end them in order
            )
        finally:
            if output:
                output.close()
        child.started_s, child.restart_at_s = self.clock_s(), None

    def _output(self, name: str) -> IO[bytes] | None:
        if self.log_dir is None:
            return None
        self.log_dir.mkdir(parents=True, exist_ok=True)
        return (self.log_dir / f"{name}.log").open("ab")

    def _handle_death(self, child: _Child, return_code: int) -> None:
        lived_s = self.clock_s() - child.started_s
        child.process = None
        child.deaths_in_a_row = 1 if lived_s >= HEALTHY_S else child.deaths_in_a_row + 1
        what = f"{child.spec.name} {_how(return_code)} after {lived_s:.1f} s"
        if return_code == EXIT_FAILED and not child.restarts and child.spec.name in self.final_refusals:
            child.given_up = True
            self.say(f"{what}: it says above what to do")
            return
        if child.deaths_in_a_row >= HOPELESS_STARTS:
            child.given_up = True
            self.say(f"{what}: it ended {child.deaths_in_a_row} times in a row and is given up; see its log")
            return
        back_off_s = min(LONGEST_BACK_OFF_S, FIRST_BACK_OFF_S * 2 ** (child.deaths_in_a_row - 1))
        child.restart_at_s = self.clock_s() + back_off_s
        self.say(f"{what}: starting it again in {back_off_s:g} s (restart {child.restarts + 1})")

    def _end(self, group: Sequence[_Child], deadline_s: float) -> None:
        processes = [child.process for child in group if child.process is not None]
        for process in processes:
            _signal_group(process, signal.SIGTERM)
        end_s = time.monotonic() + deadline_s
        for process in processes:
            try:
                process.wait(max(0.0, end_s - time.monotonic()))
            except subprocess.TimeoutExpired:
                self.say(f"pid {process.pid} did not end within {deadline_s:g} s and was killed")
            # also after a normal end: a grandchild must not outlive its parent
            _signal_group(process, signal.SIGKILL)
            process.wait()
        for child in group:
            child.process = None


def _signal_group(process: subprocess.Popen[bytes], number: int) -> None:
    try:
        os.killpg(process.pid, number)
    except ProcessLookupError:
        return


def _how(return_code: int) -> str:
    if return_code < 0:
        return f"was killed by {signal.Signals(-return_code).name}"
    return f"ended with status {return_code}"
