"""The bytes of a serial line, never waited for: what does not fit into its buffer now is lost, and sent again."""

from __future__ import annotations

import contextlib
import os
import select

import serial

from acquire.contract.errors import SweepscopeError


class LinkLostError(SweepscopeError):
    """The controller does not answer."""


def write_now(port: serial.Serial, out: bytes) -> None:
    """A pty or USB buffer takes some kilobytes: what does not fit now is lost to the line, and sent again."""
    if out:
        with contextlib.suppress(BlockingIOError):
            os.write(port.fileno(), out)


def read_now(port: serial.Serial) -> bytes:
    """What has arrived.

    Raises:
        LinkLostError: the line is gone.
    """
    try:
        data = os.read(port.fileno(), 4096)
    except BlockingIOError:
        return b""
    if not data and not _is_there(port):
        raise LinkLostError("the cable was pulled")
    return data


def _is_there(port: serial.Serial) -> bool:
    """An empty read means no data, or a line that is gone: asking for the count tells."""
    try:
        return port.in_waiting >= 0
    except OSError:
        return False


def wait_readable(timeout_s: float, *fds: int) -> None:
    """Back when one of the descriptors has something to read, or after ``timeout_s``."""
    poller = select.poll()
    for fd in fds:
        poller.register(fd, select.POLLIN)
    poller.poll(timeout_s * 1000)
