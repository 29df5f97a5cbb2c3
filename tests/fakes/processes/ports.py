"""Ports that nobody listens on now, for programs that must be told theirs."""

from __future__ import annotations

import random
import socket
from contextlib import ExitStack


def free_port(count: int = 1) -> int:
    """The first of ``count`` consecutive free ports; below those that the kernel gives to others."""
    for _ in range(200):
        port = random.randint(20_000, 31_000)
        with ExitStack() as taken:
            try:
                for offset in range(count):
                    taken.enter_context(socket.socket()).bind(("127.0.0.1", port + offset))
            except OSError:
                continue
            return port
    raise AssertionError("no free ports")
