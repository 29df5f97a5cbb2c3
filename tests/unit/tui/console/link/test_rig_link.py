"""The console's input thread over real sockets."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from textual.message import Message

from acquire.contract.states import State
from tests.fakes.fake_daemon import PROGRESS, FakeDaemon
from tests.waiting import Stopwatch, wait_for
from tui.console.link.messages import CommandAnswered, LinkChanged, PageKnown, ProgressArrived, StatusArrived, Updates
from tui.console.link.rig_link import RigLink


class Ear:
    """Collects what the link posts; waits for one of them with a deadline."""

    def __init__(self) -> None:
        self.heard: list[Message] = []
        self._news = threading.Condition()

    def __call__(self, message: Message) -> None:
        assert isinstance(message, Updates)
        with self._news:
            self.heard += message.parts
            self._news.notify_all()
        message.taken()

    def wait(self, kind: type, wanted: Callable = lambda message: True):
        def found():
            with self._news:
                return next((m for m in self.heard if isinstance(m, kind) and wanted(m)), None)

        return wait_for(found, f"such a {kind}", why=lambda: self.heard)

    def forget(self) -> None:
        with self._news:
            self.heard.clear()


@contextmanager
def linked(run_dir: Path | None, command_timeout_s: float = 5.0) -> Iterator[tuple[RigLink, Ear]]:
    ear = Ear()
    link = RigLink(ear, run_dir=run_dir, command_timeout_s=command_timeout_s)
    link.start()
    try:
        yield link, ear
    finally:
        link.close()


def test_status_and_progress_reach_the_screen(run_dir):
    with FakeDaemon(run_dir) as daemon, linked(run_dir) as (_, ear):
        daemon.progress = PROGRESS
        assert ear.wait(StatusArrived).status.state == State.IDLE
        ear.wait(LinkChanged, lambda m: m.connected)
        ear.wait(ProgressArrived)


def test_the_screen_is_told_within_two_seconds_that_the_daemon_is_away_and_hears_when_it_is_back(run_dir):
    with linked(run_dir) as (_, ear):
        with FakeDaemon(run_dir):
            ear.wait(LinkChanged, lambda m: m.connected)
        ear.forget()
        watch = Stopwatch()
        ear.wait(LinkChanged, lambda m: not m.connected)
        assert watch.elapsed_s < 2.0
        ear.forget()
        with FakeDaemon(run_dir):
            ear.wait(LinkChanged, lambda m: m.connected)
            ear.wait(StatusArrived)


def test_a_command_is_answered(run_dir):
    with FakeDaemon(run_dir) as daemon, linked(run_dir) as (link, ear):
        ear.wait(LinkChanged, lambda m: m.connected)
        link.send("scan", name="ear")
        assert daemon.asked("scan") == {"name": "ear"}
        answer = ear.wait(CommandAnswered)
        assert (answer.name, answer.ok, answer.detail) == ("scan", True, "/data/20260101T120000Z-ear")
        assert answer.at_mono_ns > 0


def test_a_refusal_is_answered_in_the_daemons_words(run_dir):
    with FakeDaemon(run_dir) as daemon, linked(run_dir) as (link, ear):
        daemon.refuse["scan"] = "home it first"
        ear.wait(LinkChanged, lambda m: m.connected)
        link.send("scan")
        answer = ear.wait(CommandAnswered)
        assert not answer.ok and answer.detail == "home it first"


def test_a_command_is_not_kept_for_a_daemon_that_is_away(run_dir):
    with linked(run_dir) as (link, ear):
        with FakeDaemon(run_dir):
            ear.wait(LinkChanged, lambda m: m.connected)
        ear.wait(LinkChanged, lambda m: not m.connected)
        for name in ("scan", "stop"):
            link.send(name)
            answer = ear.wait(CommandAnswered, lambda m, name=name: m.name == name)
            assert not answer.ok and "not connected" in answer.detail
        ear.forget()
        with FakeDaemon(run_dir) as later:
            ear.wait(StatusArrived)
            link.send("pause")
            later.asked("pause")
            assert [name for name, _ in later.commands] == ["pause"]


def test_a_daemon_that_is_there_but_silent_is_sent_nothing_but_stop(run_dir):
    with FakeDaemon(run_dir) as daemon, linked(run_dir) as (link, ear):
        ear.wait(LinkChanged, lambda m: m.connected)
        daemon.silent = True
        ear.wait(LinkChanged, lambda m: not m.connected)
        link.send("scan")
        assert not ear.wait(CommandAnswered).ok
        link.send("stop")
        daemon.asked("stop")
        assert [name for name, _ in daemon.commands] == ["stop"]


def test_a_deaf_daemon_is_asked_twice_and_then_given_up(run_dir):
    with FakeDaemon(run_dir) as daemon, linked(run_dir, command_timeout_s=0.6) as (link, ear):
        ear.wait(LinkChanged, lambda m: m.connected)
        daemon.deaf = True
        link.send("pause")
        daemon.asked("pause", count=2)
        answer = ear.wait(CommandAnswered)
        assert not answer.ok and "whether it was done is not known" in answer.detail
        first, second = daemon.sent_mono_ns
        assert first == second > 0, "a restarted daemon could not tell that it is late"


def test_the_address_of_the_page_is_found_and_its_loss_is_told(run_dir):
    url_file = run_dir / "viewer.url"
    url_file.write_text("http://127.0.0.1:1/?token=x\n")
    with FakeDaemon(run_dir), linked(run_dir) as (_, ear):
        assert ear.wait(PageKnown).url == "http://127.0.0.1:1/?token=x"
        url_file.unlink()
        ear.wait(PageKnown, lambda m: not m.url)


def test_a_console_started_before_any_daemon_finds_it_when_it_comes(run_dir, monkeypatch):
    monkeypatch.delenv("SWEEPSCOPE_RUN", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(run_dir))
    home = run_dir / "sweepscope"
    home.mkdir(mode=0o700)
    with linked(None) as (link, ear):
        ear.wait(LinkChanged, lambda m: not m.connected)
        link.send("scan")
        assert not ear.wait(CommandAnswered).ok
        with FakeDaemon(home):
            ear.wait(LinkChanged, lambda m: m.connected)


def test_a_burst_of_states_is_painted_no_faster_than_ten_times_a_second(run_dir):
    with FakeDaemon(run_dir, frames_per_tick=1, expected=100_000) as daemon, linked(run_dir) as (link, ear):
        ear.wait(LinkChanged, lambda m: m.connected)
        link.send("scan")
        daemon.asked("scan")
        ear.forget()
        for name in ["status"] * 200:
            link.send(name)
        begin_s = time.monotonic()
        daemon.asked("status", count=200)
        painted = sum(isinstance(message, StatusArrived) for message in list(ear.heard))
        assert painted <= 2 + (time.monotonic() - begin_s) * 10


def test_a_closed_link_leaves_no_descriptor(run_dir):
    def descriptors():
        return len(os.listdir("/proc/self/fd"))  # noqa: PTH208

    with FakeDaemon(run_dir):
        with linked(run_dir) as (_, ear):
            ear.wait(StatusArrived)
        before = descriptors()
        for _ in range(3):
            with linked(run_dir) as (_, ear):
                ear.wait(StatusArrived)
        assert descriptors() <= before


def test_a_socket_path_that_is_too_long_is_told_not_raised(tmp_path):
    deep = tmp_path / ("x" * 120)
    deep.mkdir()
    with linked(deep) as (_, ear):
        assert "longer than" in ear.wait(LinkChanged).detail
