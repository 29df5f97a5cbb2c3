"""`sweepscope up` and `sweepscope demo` with the real services."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from acquire.contract.process.run_dir import is_served
from acquire.contract.states import State
from tests import ROOT
from tests.waiting import WALL_CLOCK_S, exit_status, output_of, run, still_alive, wait_for
from tui.client.rig_client import RigClient

SERVICES = {"daemon", "writer", "worker", "viewer"}
RIG = """
[storage]
data_dir = "{data_dir}"
[camera]
width = 128
height = 96
[sweep]
last_steps = 1500
steps_per_frame = 50
[simulation]
time_scale = 0.05
[viewer]
port = 0
"""


def services_of(pid: int) -> dict[str, psutil.Process]:
    """The living services below a process, by name."""
    found = {}
    for child in psutil.Process(pid).children():
        with contextlib.suppress(psutil.NoSuchProcess):
            words = SERVICES & set(child.cmdline())
            if words and child.status() != psutil.STATUS_ZOMBIE:
                found[words.pop()] = child
    return found


class Up:
    """A running `sweepscope up`."""

    def __init__(self, folder: Path, run_dir: Path) -> None:
        (folder / "rig.toml").write_text(RIG.format(data_dir=folder / "scans"))
        self.run_dir = run_dir
        self.log = folder / "up.log"
        command = [sys.executable, "-m", "tui.cli", "--config", str(folder / "rig.toml"), "up"]
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                command, env={**os.environ, "SWEEPSCOPE_RUN": str(run_dir)}, stdout=log, stderr=log
            )

    def ready(self) -> bool:
        assert self.process.poll() is None, self.log.read_text()
        lanes = is_served(self.run_dir) and is_served(self.run_dir, "results")
        return lanes and (self.run_dir / "viewer.url").exists() and set(services_of(self.process.pid)) == SERVICES

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()
            exit_status(self.process)


@pytest.fixture
def up(tmp_path: Path, run_dir: Path) -> Iterator[Up]:
    running = Up(tmp_path, run_dir)
    try:
        wait_for(running.ready, "all services", why=running.log.read_text)
        yield running
    finally:
        running.end()


def test_a_killed_service_is_started_again_the_page_is_told_and_sigterm_ends_all(up):
    assert "http://127.0.0.1:" in up.log.read_text()
    before = services_of(up.process.pid)
    before["writer"].kill()
    writer = before["writer"]
    wait_for(lambda: services_of(up.process.pid).get("writer", writer).pid != writer.pid, "another writer")
    assert "writer was killed by SIGKILL" in up.log.read_text()
    with RigClient(up.run_dir) as client:
        ready = client.wait_for(lambda status: status.writer_alive and status.state == State.IDLE, WALL_CLOCK_S)
        assert ready is not None
    up.process.send_signal(signal.SIGTERM)
    assert exit_status(up.process) == 0
    assert len(before) == len(SERVICES) and still_alive(before.values()) == []


def test_a_killed_parent_leaves_no_orphan(up):
    children = list(services_of(up.process.pid).values())
    up.process.kill()
    up.process.wait()
    assert still_alive(children) == []


def test_a_second_up_in_the_same_place_is_refused(up, tmp_path):
    (tmp_path / "second").mkdir()
    second = Up(tmp_path / "second", up.run_dir)
    assert exit_status(second.process) == 1
    said = second.log.read_text()
    assert said.startswith("sweepscope: a daemon already runs in") and said.count("\n") == 1


def test_the_demonstration_without_a_terminal_succeeds_and_leaves_nothing_running(tmp_path):
    arguments = ["--size", "256x192", "--frames", "100", "--time-scale", "0.1"]
    command = [sys.executable, "-m", "tui.cli", "demo", *arguments]
    (tmp_path / "rig.toml").write_text("this is not TOML")
    root = str(ROOT)
    done = run(command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": root}, stdin=subprocess.DEVNULL)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == ""
    for words in ("SWEEPING", "SAVED: 100 of 100", "visible pixels", "median", "timings", "cloud.ply", "?token="):
        assert words in done.stdout
    (report,) = (tmp_path / "demo-data").glob("*-demo-stirrup/report.json")
    assert json.loads(report.read_text())["outcome"] == "complete"


def test_the_demonstration_that_is_interrupted_keeps_what_was_taken(tmp_path):
    command = [sys.executable, "-m", "tui.cli", "demo", "--size", "128x96", "--time-scale", "1"]
    root = str(ROOT)
    running = subprocess.Popen(
        command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": root}, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    assert running.stdout is not None
    for line in running.stdout:
        if line.startswith("SWEEPING"):
            break
    children = list(services_of(running.pid).values())
    running.send_signal(signal.SIGINT)
    said, _ = output_of(running)
    assert running.returncode == 130
    assert "cancelled; what was taken is kept" in said
    assert still_alive(children) == []
    assert list((tmp_path / "demo-data").glob("*/scan.h5"))
