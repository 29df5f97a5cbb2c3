"""sd_notify: readiness and watchdog messages to systemd; without systemd nothing is sent."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping

from acquire.contract.process.clocks import mono_ns
from acquire.contract.units import NS_PER_S

_BEATS_PER_LIMIT = 4
"""Watchdog messages in one watchdog period: three may be late before systemd restarts the service."""


class Notifier:
    """Sends sd_notify(3) messages to ``$NOTIFY_SOCKET``; without one every call does nothing.

    Call :meth:`alive` from the main loop itself, after its work: a thread of its own would hide a loop that hangs.
    """

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        address = environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._period_ns = _watchdog_ns(environ) // _BEATS_PER_LIMIT
        self._due_ns = 0

    def ready(self, status: str) -> None:
        """The service is ready."""
        self._send(f"READY=1\nSTATUS={status}")

    def stopping(self) -> None:
        """The service is ending."""
        self._send("STOPPING=1")

    def alive(self) -> None:
        """One turn of the main loop is done; the watchdog is told at most four times per period."""
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
                return  # systemd does not read: waiting for it could cost a frame


def _watchdog_ns(environ: Mapping[str, str]) -> int:
    """The watchdog period in ns if it is set for this process, else 0."""
    text, pid = environ.get("WATCHDOG_USEC", ""), environ.get("WATCHDOG_PID", "")
    if not text.isdigit() or (pid and pid != str(os.getpid())):
        return 0
    return int(text) * NS_PER_S // 1_000_000
