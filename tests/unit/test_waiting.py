"""Deadlines of the tests: a hang reaches them, a busy machine does not."""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from tests import ROOT, waiting
from tests.waiting import (
    MachineShare,
    UndisturbedClock,
    exit_status,
    fair_share,
    next_of,
    output_of,
    run,
    share_got,
    wait_for,
)


@pytest.mark.parametrize(("runnable", "cores", "share"), [(0, 2, 1.0), (2, 2, 1.0), (4, 2, 0.5), (10, 2, 0.2)])
def test_each_thread_has_a_fair_share_of_the_cores(runnable: int, cores: int, share: float) -> None:
    assert fair_share(runnable, cores) == share


@pytest.mark.parametrize(
    ("ran_s", "waited_s", "share"),
    [(0.0, 0.0, 1.0), (1.0, 0.0, 1.0), (0.2, 0.8, 0.2), (0.4, 1.6, 0.2), (0.01, 0.01, 0.99)],
    ids=["all rest", "one computes", "one computes a fifth of the time", "two do", "one hangs and looks now and then"],
)
def test_only_what_was_waited_for_a_core_does_not_count(ran_s: float, waited_s: float, share: float) -> None:
    assert share_got(ran_s, waited_s, 1.0) == pytest.approx(share)


def test_processes_that_fight_for_one_core_get_their_part_of_it_and_sleepers_miss_nothing() -> None:
    (core, *_), measure = os.sched_getaffinity(0), MachineShare()
    code = f"import os\nos.sched_setaffinity(0, [{core}])\nwhile True: pass"
    fighters = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(4)]
    try:
        time.sleep(0.5)  # they start
        measure(0.5)
        time.sleep(1.0)
        assert measure(1.0) < 0.4
    finally:
        for fighter in fighters:
            fighter.kill()
            fighter.wait()


def test_a_second_of_a_busy_machine_counts_as_what_was_got_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    now, shares = [100.0], iter((1.0, 0.25, 0.125))
    monkeypatch.setattr(waiting.time, "monotonic", lambda: now[0])
    clock = UndisturbedClock(lambda _wall_s: next(shares))
    clock._sampler = threading.current_thread()
    begin_s = clock.now_s()
    for _ in range(3):
        now[0] += 8.0
        clock.sample()
    assert clock.now_s() - begin_s == pytest.approx(8.0 + 2.0 + 1.0)


def machine(monkeypatch: pytest.MonkeyPatch, share: float) -> None:
    clock = UndisturbedClock(lambda _wall_s: share)
    clock.sample()
    monkeypatch.setattr(waiting, "CLOCK", clock)
    clock._sampler = threading.current_thread()  # no second thread: this test's load never changes


def test_a_hang_is_told_with_what_was_waited_for_and_why(monkeypatch: pytest.MonkeyPatch) -> None:
    machine(monkeypatch, 1.0)
    with pytest.raises(AssertionError, match=r"0.1 s of an undisturbed machine: a frame\nno writer"):
        wait_for(lambda: False, "a frame", 0.1, why=lambda: "no writer")
    with pytest.raises(AssertionError, match="an event"):
        next_of(queue.Queue(), 0.1)


def test_what_is_late_on_a_busy_machine_is_no_hang(monkeypatch: pytest.MonkeyPatch) -> None:
    machine(monkeypatch, 0.01)
    begin_s = time.monotonic()
    assert wait_for(lambda: time.monotonic() - begin_s > 0.5, "half a second", 0.1)


def test_a_process_that_hangs_is_ended_and_what_it_said_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    machine(monkeypatch, 1.0)
    code = "import time; print('so far', flush=True); time.sleep(60)"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with pytest.raises(AssertionError, match="so far"):
        output_of(process, 2.0)
    assert exit_status(process) != 0


def test_a_command_gives_its_status_and_all_its_output() -> None:
    done = run([sys.executable, "-c", "import sys; print('x' * 200_000); sys.exit(3)"])
    assert (done.returncode, len(done.stdout), done.stderr) == (3, 200_001, "")
    with pytest.raises(subprocess.CalledProcessError):
        run([sys.executable, "-c", "raise SystemExit(1)"], check=True)


@pytest.mark.parametrize(("share", "words"), [(1.0, "Timeout (>1.0s)"), (0.01, "1 passed")])
def test_the_time_limit_of_a_test_ends_a_hang_and_waits_for_a_busy_machine(
    tmp_path: Path, share: float, words: str
) -> None:
    (tmp_path / "conftest.py").write_text(
        "from tests import waiting\n"
        "from tests.conftest import pytest_timeout_set_timer\n"
        f"waiting.CLOCK._ask = lambda _wall_s: {share}\n"
    )
    (tmp_path / "test_slow.py").write_text("import time\ndef test_slow(): time.sleep(3)\n")
    command = [sys.executable, "-m", "pytest", "-q", "--timeout=1", "--rootdir", tmp_path, tmp_path]
    done = run(command, cwd=ROOT)
    assert words in done.stdout, done.stdout
