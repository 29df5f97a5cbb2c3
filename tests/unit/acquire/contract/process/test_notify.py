"""What a service tells systemd."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from acquire.contract.process.notify import Notifier


@pytest.fixture
def manager(run_dir: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(run_dir / "notify"))
        listener.settimeout(0.2)
        yield listener


def environ(manager: socket.socket, **more: str) -> dict[str, str]:
    return {"NOTIFY_SOCKET": manager.getsockname(), **more}


def test_readiness_is_said_with_a_status(manager: socket.socket) -> None:
    Notifier(environ(manager)).ready("all well")
    assert manager.recv(100) == b"READY=1\nSTATUS=all well"


def test_signs_of_life_are_rationed(manager: socket.socket) -> None:
    notifier = Notifier(environ(manager, WATCHDOG_USEC="60000000"))
    for _ in range(100):
        notifier.alive()
    assert manager.recv(100) == b"WATCHDOG=1"
    with pytest.raises(TimeoutError):
        manager.recv(100)


@pytest.mark.parametrize("more", [{}, {"WATCHDOG_USEC": "abc"}, {"WATCHDOG_USEC": "1000", "WATCHDOG_PID": "1"}])
def test_without_a_watchdog_for_us_no_sign_of_life_is_sent(manager: socket.socket, more: dict[str, str]) -> None:
    assert os.getpid() != 1
    Notifier(environ(manager, **more)).alive()
    with pytest.raises(TimeoutError):
        manager.recv(100)


@pytest.mark.parametrize("name", ["notify", "@sweepscope-test-{pid}"])
def test_a_manager_that_listens_later_is_told_then_and_its_absence_harms_nothing(run_dir: Path, name: str) -> None:
    address = name.format(pid=os.getpid()) if name.startswith("@") else str(run_dir / name)
    notifier = Notifier({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1000000"})
    notifier.ready("too early")
    notifier.alive()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(address.replace("@", "\0"))
        listener.settimeout(0.2)
        notifier.stopping()
        assert listener.recv(100) == b"STOPPING=1"


def test_a_manager_that_does_not_read_holds_no_service_up(manager: socket.socket) -> None:
    notifier = Notifier(environ(manager))
    for _ in range(10_000):  # more than a socket's queue takes
        notifier.stopping()
    assert manager.recv(100) == b"STOPPING=1"


def test_without_systemd_nothing_is_sent(manager: socket.socket) -> None:
    notifier = Notifier({})
    notifier.ready("x")
    notifier.alive()
    with pytest.raises(TimeoutError):
        manager.recv(100)
