"""The parent of the services, with small children of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from tests import ROOT
from tests.waiting import wait_for
from tui.processes.supervisor import HOPELESS_STARTS, ServiceSpec, Supervisor

SLEEPER = "import signal, sys; print('up', flush=True); signal.pause()"
STUBBORN = (
    "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('up', flush=True)\nwhile True: signal.pause()"
)
FOLLOWER = (
    "from tui.processes.parent_watch import follow_parent; import signal; "
    "follow_parent(); print('up', flush=True); signal.pause()"
)
ORDERED = (
    "import signal, sys, time, pathlib\n"
    "def end(*_): pathlib.Path(sys.argv[1]).write_text(str(time.monotonic())); sys.exit(0)\n"
    "signal.signal(signal.SIGTERM, end); print('up', flush=True); signal.pause()"
)


def child(name: str, code: str, *arguments: str) -> ServiceSpec:
    return ServiceSpec(name, (sys.executable, "-c", code, *arguments))


def wait(happened: Callable[[], bool], supervisor: Supervisor | None = None) -> None:
    def pause() -> None:
        if supervisor is not None:
            supervisor.tend()
        time.sleep(0.02)

    wait_for(happened, "what is waited for", pause=pause)


@pytest.fixture
def keep(tmp_path):
    """Make supervisors that are stopped whatever a test does."""
    made: list[Supervisor] = []

    def make(*specs: ServiceSpec, **settings) -> tuple[Supervisor, list[str]]:
        said: list[str] = []
        environ = {**os.environ, "PYTHONPATH": str(ROOT)}
        supervisor = Supervisor(specs, environ, said.append, log_dir=tmp_path, **settings)
        made.append(supervisor)
        supervisor.start()
        return supervisor, said

    yield make
    for supervisor in made:
        supervisor.stop(2.0)


def up(tmp_path: Path, name: str, times: int = 1) -> Callable[[], bool]:
    def check() -> bool:
        log = tmp_path / f"{name}.log"
        return log.exists() and log.read_text().count("up") >= times

    return check


def test_a_killed_child_is_started_again_and_that_is_said(keep, tmp_path):
    supervisor, said = keep(child("a", SLEEPER))
    wait(up(tmp_path, "a"))
    os.kill(supervisor.pids["a"], signal.SIGKILL)
    wait(up(tmp_path, "a", times=2), supervisor)
    assert supervisor.restarts == {"a": 1}
    assert "a was killed by SIGKILL" in said[0] and "restart 1" in said[0]


def test_a_child_that_cannot_live_is_given_up_after_growing_pauses(keep):
    now = [0.0]
    supervisor, said = keep(child("a", "raise SystemExit(3)"), clock_s=lambda: now[0])

    def tick() -> bool:
        now[0] += 0.05
        return bool(supervisor.given_up)

    wait(tick, supervisor)
    assert supervisor.given_up == ["a"]
    assert len(said) == HOPELESS_STARTS
    assert "status 3" in said[0] and "given up" in said[-1]
    pauses = [float(line.partition("again in ")[2].split(" ")[0]) for line in said[:-1]]
    assert pauses == sorted(pauses) and pauses[-1] > pauses[0]


def test_the_first_child_is_ended_before_the_others(keep, tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    supervisor, _ = keep(child("a", ORDERED, str(first)), child("b", ORDERED, str(second)))
    wait(lambda: up(tmp_path, "a")() and up(tmp_path, "b")())
    supervisor.stop(5.0)
    assert float(first.read_text()) < float(second.read_text())


def test_a_child_that_ignores_sigterm_is_killed_at_the_deadline(keep, tmp_path):
    supervisor, said = keep(child("a", STUBBORN))
    wait(up(tmp_path, "a"))
    pid = supervisor.pids["a"]
    supervisor.stop(0.2)
    assert not psutil.pid_exists(pid)
    assert any("was killed" in line for line in said)


def test_nothing_is_started_again_after_the_end(keep, tmp_path):
    supervisor, _ = keep(child("a", SLEEPER))
    wait(up(tmp_path, "a"))
    supervisor.stop(2.0)
    supervisor.tend()
    assert supervisor.pids == {}


def test_a_child_follows_its_killed_supervisor(tmp_path):
    code = (
        "import os, signal, sys\n"
        "from tui.processes.supervisor import ServiceSpec, Supervisor\n"
        f"spec = ServiceSpec('a', (sys.executable, '-c', {FOLLOWER!r}))\n"
        "supervisor = Supervisor([spec], os.environ, print)\n"
        "supervisor.start(); print(supervisor.pids['a'], flush=True); signal.pause()\n"
    )
    root = ROOT
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=root)
    assert parent.stdout is not None
    lines = {parent.stdout.readline().strip(), parent.stdout.readline().strip()}
    pid = int(next(line for line in lines if line.isdigit()))
    assert "up" in lines
    parent.kill()
    parent.wait()
    parent.stdout.close()
    try:
        wait(lambda: not psutil.pid_exists(pid))
    finally:
        if psutil.pid_exists(pid):
            os.kill(pid, signal.SIGKILL)


def test_a_gateway_is_started_only_where_the_rig_is_offered_to_other_machines():
    from tui.processes.all_services import service_specs

    assert "gateway" not in [spec.name for spec in service_specs(None)]
    assert [spec.name for spec in service_specs(None, remote=True)][-1] == "gateway"
