"""Starts services and fakes as processes of their own, leaves none behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.waiting import exit_status, wait_for

_WRITER = (
    "import sys; from pathlib import Path;"
    "from acquire.contract.config.load import load_config; from acquire.contract.errors import SweepscopeError;"
    "from acquire.writer.service import run_writer\n"
    "try:\n    run_writer(load_config(), Path(sys.argv[1]))\n"
    "except SweepscopeError as error:\n    sys.exit(str(error))"
)


class Child:
    """A process with its output in a file."""

    def __init__(self, arguments: list[str], log: Path, **settings: Any) -> None:
        variables = {f"SWEEPSCOPE_{name}": str(value) for name, value in settings.items()}
        self.log = log
        with log.open("ab") as output, log.with_suffix(".err").open("ab") as errors:
            self.process = subprocess.Popen(
                [sys.executable, *arguments], stdout=output, stderr=errors, env={**os.environ, **variables}
            )

    @property
    def errors(self) -> str:
        """What it wrote to stderr so far."""
        return self.log.with_suffix(".err").read_text()

    def kill(self) -> None:
        """SIGKILL; returns when it is gone."""
        self.process.kill()
        exit_status(self.process)

    def terminate(self) -> int:
        """SIGTERM; returns its exit status."""
        self.process.send_signal(signal.SIGTERM)
        return exit_status(self.process)

    def result(self, *, stays: bool = False) -> dict[str, Any]:
        """Wait for its end, or for its last line where it ``stays``; the JSON object on that line."""
        if stays:
            wait_for(lambda: self.log.read_text().endswith("\n"), "the result", why=lambda: self.errors)
        else:
            assert exit_status(self.process) == 0, self.errors
        found = json.loads(self.log.read_text().splitlines()[-1])
        assert isinstance(found, dict)
        return found


class Bench:
    """A private place for a writer, a fake camera and what they write."""

    def __init__(self, run_dir: Path, folder: Path) -> None:
        self.run_dir, self.folder = run_dir, folder
        self.scan = folder / "scan"
        self.witness = folder / "witness.log"
        self.acks = folder / "acks.log"
        self._children: list[Child] = []

    def start(self, name: str, arguments: list[str], **settings: Any) -> Child:
        """Start a process; it is ended with the bench."""
        child = Child(arguments, self.folder / f"{name}{len(self._children)}.log", **settings)
        self._children.append(child)
        return child

    def writer(self, **settings: Any) -> Child:
        """Start a writer; ``settings`` are SECTION__KEY of the configuration."""
        return self.start("writer", ["-c", _WRITER, str(self.run_dir)], **settings)

    def camera(self, frames: int, **knobs: Any) -> Child:
        """Start a fake camera with its witness and the tap of its acks."""
        places = {"run_dir": self.run_dir, "scan": self.scan, "witness": self.witness, "acks": self.acks}
        options = {"frames": frames, **places, **knobs}
        arguments = [part for name, value in options.items() for part in (f"--{name.replace('_', '-')}", str(value))]
        return self.start("camera", ["-m", "tests.fakes.fake_camera", *arguments])

    def acked(self) -> list[int]:
        """Frames that were acked so far, in order."""
        if not self.acks.exists():
            return []
        lines = self.acks.read_text().splitlines(keepends=True)
        return [int(line.split()[0]) for line in lines if line.endswith("\n")]

    def end(self) -> None:
        """Kill what still runs."""
        for child in self._children:
            if child.process.poll() is None:
                child.kill()


@contextmanager
def bench_at(run_dir: Path, folder: Path) -> Iterator[Bench]:
    """A bench whose processes are gone at the end."""
    bench = Bench(run_dir, folder)
    try:
        yield bench
    finally:
        bench.end()
