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


@pytest.mark.parametrize("address", ["", "/nonexistent/notify", "@nobody-listens-here"])
def test_where_nobody_listens_nothing_happens(address: str) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1000000"})
    notifier.ready("x")
    notifier.alive()
    notifier.stopping()
