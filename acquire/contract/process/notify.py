"""Owns what a service tells systemd: ready when it really is, alive while its main loop turns; silent elsewhere."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping

from acquire.contract.process.clocks import mono_ns
from acquire.contract.units import NS_PER_S

_BEATS_PER_LIMIT = 4
"""Signs of life within one watchdog period: three may be late before the service counts as stuck."""


class Notifier:
    """Speaks sd_notify(3)'s protocol to ``$NOTIFY_SOCKET``; without one every call does nothing.

    Call :meth:`alive` from the main loop itself, after its work: a thread of its own would vouch for a stuck loop.
    """

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        address = environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._period_ns = _watchdog_ns(environ) // _BEATS_PER_LIMIT
        self._due_ns = 0

    def ready(self, status: str) -> None:
        """The service does its work from now on."""
        self._send(f"READY=1\nSTATUS={status}")

    def stopping(self) -> None:
        """The service brings its work to an end."""
        self._send("STOPPING=1")

    def alive(self) -> None:
        """One turn of the main loop is done; sent to the watchdog four times per limit, not oftener."""
        if not self._period_ns:
            return
        now_ns = mono_ns()
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + self._period_ns
            self._send("WATCHDOG=1")

    def _send(self, text: str) -> None:
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as out:
            try:
                out.setblocking(False)
                out.sendto(text.encode(), self._address)
            except OSError:
                return  # nobody listens, or too busy to: a sign of life is never worth a frame


def _watchdog_ns(environ: Mapping[str, str]) -> int:
    """The watchdog's limit in ns if it is meant for this process, else 0."""
    text, pid = environ.get("WATCHDOG_USEC", ""), environ.get("WATCHDOG_PID", "")
    if not text.isdigit() or (pid and pid != str(os.getpid())):
        return 0
    return int(text) * NS_PER_S // 1_000_000
