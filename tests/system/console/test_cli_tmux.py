"""The console in a real terminal (tmux), against a daemon that answers as a real one does."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from acquire.contract.states import State
from tests.fakes.fake_daemon import FakeDaemon
from tests.fakes.processes.launch import bench_at
from tests.unit.rig_in_process import RigInProcess
from tests.waiting import Stopwatch, run, still_alive, wait_for

SLOW_S = 100.0
"""Services start, and child processes compile and compute, before some words appear."""


class Terminal:
    """A tmux server of its own with one window; what is on the screen is waited for, never slept for."""

    def __init__(self, tmux: str, folder: Path, run_dir: Path) -> None:
        self._tmux = [tmux, "-S", str(folder / "tmux.sock"), "-f", "/dev/null"]
        self.environ = {**os.environ, "SWEEPSCOPE_RUN": str(run_dir), "TERM": "xterm-256color", "TMUX": ""}
        self.environ.pop("TMUX")

    def _do(self, *arguments: str) -> str:
        command = [*self._tmux, *arguments]
        return run(command, check=True, env=self.environ).stdout

    def open(self, *command: str, width: int = 80, height: int = 24) -> None:
        shell = " ".join(command) + "; echo STATUS=$?; exec sleep 60"
        self._do("new-session", "-d", "-x", str(width), "-y", str(height), shell)

    def press(self, *keys: str) -> None:
        self._do("send-keys", *keys)

    def resize(self, width: int, height: int) -> None:
        self._do("resize-window", "-x", str(width), "-y", str(height))

    @property
    def screen(self) -> str:
        return self._do("capture-pane", "-p")

    def wait_for(self, *words: str) -> str:
        """The screen, once all words are on it."""

        def shown() -> str:
            screen = self.screen
            return screen if all(word in screen for word in words) else ""

        return wait_for(shown, f"{words} on the screen", SLOW_S, why=lambda: self.screen)

    def wait_until_gone(self, word: str) -> None:
        wait_for(lambda: word not in self.screen, f"a screen without {word}", why=lambda: self.screen)

    def close(self) -> None:
        run([*self._tmux, "kill-server"])


@pytest.fixture
def terminal(tmux: str, tmp_path: Path, run_dir: Path) -> Iterator[Terminal]:
    made = Terminal(tmux, run_dir, run_dir)
    yield made
    made.close()


CONSOLE = (sys.executable, "-m", "tui.cli", "console")


def test_a_whole_session_in_a_real_terminal_from_the_preview_to_the_stop(terminal, run_dir, tmp_path):
    settings = {
        "simulation.time_scale": 1.0,
        "sweep.max_rate_hz": 10.0,
        "sweep.steps_per_frame": 3,
        "limits.writer_start_s": 20.0,
    }
    with RigInProcess(run_dir, tmp_path / "scans", settings), bench_at(run_dir, tmp_path) as bench:
        bench.writer(STORAGE__DATA_DIR=tmp_path / "scans")
        terminal.open(*CONSOLE)
        terminal.wait_for("IDLE", "s start")
        terminal.press("v")
        terminal.wait_for("PREVIEW", " px  ")
        for where, key, shown in (("120", "f", "first    120"), ("480", "l", "last     480")):
            terminal.press("t")
            terminal.wait_for("go to", "Escape leaves")
            terminal.press(where, "Enter")
            terminal.wait_for(f"  {where} microsteps")
            terminal.press(key)
            terminal.wait_for(shown)
        terminal.wait_for("121 frames")
        terminal.press("s")
        terminal.wait_for("start a sweep")
        terminal.press("ear", "Enter")
        terminal.wait_for("SWEEPING", "frames/s", "remaining")
        terminal.press("p")
        terminal.wait_for("HOLDING (paused)")
        terminal.press("r")
        terminal.wait_for("SWEEPING", "p pause")
        terminal.press("Space")
        terminal.wait_for("stopped: ", "of 121 frames are safe")
        terminal.wait_until_gone("STOP sent")
        terminal.press("q")
        terminal.wait_for("STATUS=0")
    assert [path.name.partition("-")[2] for path in (tmp_path / "scans").iterdir()] == ["ear"]


def test_the_console_starts_without_a_daemon_and_reconnects_by_itself(terminal, run_dir):
    terminal.open(*CONSOLE, width=100, height=30)
    terminal.wait_for("NOT CONNECTED - RETRYING")
    with FakeDaemon(run_dir):
        terminal.wait_for("IDLE", "s start")
    watch = Stopwatch()
    terminal.wait_for("last known: IDLE")
    assert watch.elapsed_s < 2.5
    with FakeDaemon(run_dir):
        terminal.wait_for("IDLE", "s start")
    terminal.press("q")
    terminal.wait_for("STATUS=0")


def test_a_window_resized_in_mid_sweep_keeps_showing_it_and_stop_works_when_it_is_tiny(terminal, run_dir):
    with FakeDaemon(run_dir, frames_per_tick=1, expected=100_000) as daemon:
        terminal.open(*CONSOLE)
        terminal.wait_for("s start")
        terminal.press("s")
        terminal.wait_for("start a sweep")
        terminal.press("Enter")
        terminal.wait_for("SWEEPING")
        terminal.resize(160, 50)
        terminal.wait_for("SWEEPING", "lag: camera", "SPACE = STOP")
        terminal.resize(40, 12)
        terminal.wait_for("smaller than")
        terminal.press("Space")
        daemon.asked("stop")
        assert daemon.status.state == State.IDLE
        terminal.press("q")
        terminal.wait_for("STATUS=0")


def test_the_demonstration_opens_the_console_starts_at_once_asks_before_it_ends_and_ends_all(terminal, tmp_path):
    demo = (sys.executable, "-m", "tui.cli", "demo", "--size", "128x96", "--data-dir", str(tmp_path / "data"))
    terminal.open(*demo, width=100, height=30)
    screen = terminal.wait_for("SWEEPING", "frames/s", "?token=")
    assert "http://127.0.0.1:" in screen
    services = [child for child in psutil.process_iter() if str(tmp_path) in _open_logs(child)]
    assert len(services) == 4
    terminal.press("q")
    terminal.wait_for("y  end it and leave")
    terminal.press("n")
    terminal.wait_until_gone("y  end it and leave")
    terminal.press("q")
    terminal.wait_for("y  end it and leave")

    def answered() -> bool:  # what is typed before it can be read does not count
        terminal.press("y")
        return "y  end it and leave" not in terminal.screen

    wait_for(answered, "an end of the question")
    terminal.wait_for("page     http://127.0.0.1:", "STATUS=0")
    assert still_alive(services) == []


def _open_logs(process: psutil.Process) -> str:
    try:
        return os.readlink(f"/proc/{process.pid}/fd/1")  # noqa: PTH115
    except OSError:
        return ""


def test_an_exported_size_does_not_keep_the_console_from_following_its_window(terminal, run_dir):
    with FakeDaemon(run_dir):
        terminal.open("COLUMNS=80", "LINES=24", *CONSOLE, width=160, height=50)
        screen = terminal.wait_for("SPACE = STOP")
        assert max(map(len, screen.splitlines())) > 100
        terminal.press("q")
        terminal.wait_for("STATUS=0")
