"""Non-blocking bytes on the serial port. What does not fit into its buffer is dropped; the protocol sends it again."""

from __future__ import annotations

import os
import select

import serial

from acquire.contract.errors import SweepscopeError


class LinkLostError(SweepscopeError):
    """The controller does not answer."""


def write_now(port: serial.Serial, out: bytes) -> None:
    """Write what fits into the buffer of the pty or USB device (some kilobytes); the rest is dropped.

    Raises:
        LinkLostError: the device was removed.
    """
    if out:
        try:
            os.write(port.fileno(), out)
        except BlockingIOError:
            return
        except OSError as error:
            raise _gone(port, error) from None


def read_now(port: serial.Serial) -> bytes:
    """What has arrived.

    Raises:
        LinkLostError: the device was removed.
    """
    try:
        data = os.read(port.fileno(), 4096)
    except BlockingIOError:
        return b""
    except OSError as error:
        raise _gone(port, error) from None
    if not data and not _is_there(port):
        raise _gone(port)
    return data


def _gone(port: serial.Serial, error: OSError | None = None) -> LinkLostError:
    why = f" ({error.strerror})" if error is not None and error.strerror else ""
    return LinkLostError(f"the cable was pulled: the port {port.name} is gone{why}")


def _is_there(port: serial.Serial) -> bool:
    """An empty read means no data or a removed device; asking for the number of waiting bytes tells which."""
    try:
        return port.in_waiting >= 0
    except OSError:
        return False


def wait_readable(timeout_s: float, *fds: int) -> None:
    """Return when a descriptor is readable, or after ``timeout_s``."""
    poller = select.poll()
    for fd in fds:
        poller.register(fd, select.POLLIN)
    poller.poll(timeout_s * 1000)
