"""Opens the controller's serial port, or explains why it cannot be opened."""

from __future__ import annotations

import contextlib
import errno
import grp
import termios
from pathlib import Path

import serial
from serial.tools import list_ports

from acquire.contract.errors import SweepscopeError

_BY_ID = Path("/dev/serial/by-id")


class PortError(SweepscopeError):
    """The serial port cannot be used; the text says why and what to do."""


class PortMissingError(PortError):
    """There is no such port (now)."""


def known_ports() -> list[str]:
    """Serial ports of this machine, by their persistent names (/dev/serial/by-id) where they have one."""
    if _BY_ID.is_dir():
        named = sorted(str(path) for path in _BY_ID.iterdir())
        if named:
            return named
    return sorted(port.device for port in list_ports.comports())


def choose_port(wanted: str) -> str:
    """``wanted``, or the only port there is.

    Raises:
        PortMissingError: nothing is named and there is none, or more than one.
    """
    if wanted:
        return wanted
    ports = known_ports()
    if len(ports) == 1:
        return ports[0]
    raise PortMissingError(f"which serial port is the stage's? {_there_is(ports)}; set stage.port")


def open_port(name: str, baud: int) -> serial.Serial:
    """Open the port for ourselves alone, raw, without waiting reads.

    Raises:
        PortError: no such port, busy, no permission, or not a serial port; the text says which and what to do.
    """
    try:
        port = serial.Serial(name, baud, timeout=0, write_timeout=0, exclusive=True)
    except serial.SerialException as error:
        raise _in_words(name, error) from error
    except OSError as error:
        raise PortError(f"cannot open {name}: {error.strerror}; is it a serial port?") from error
    _keep_dtr(port)
    return port


def _keep_dtr(port: serial.Serial) -> None:
    """Leave DTR up when the port is closed: on an Uno its next rise resets the controller, and the position is lost."""
    with contextlib.suppress(termios.error):
        attributes = termios.tcgetattr(port.fileno())
        attributes[2] &= ~termios.HUPCL
        termios.tcsetattr(port.fileno(), termios.TCSANOW, attributes)


def _there_is(ports: list[str]) -> str:
    return f"there is {', '.join(ports)}" if ports else "there is none: is the cable in?"


def _in_words(name: str, error: serial.SerialException) -> PortError:
    number = getattr(error, "errno", None)
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or not Path(name).exists():
        return PortMissingError(f"no serial port {name}; {_there_is(known_ports())}")
    if number in (errno.EACCES, errno.EPERM):
        return PortError(f"no permission for {name}: {_group_hint(name)}")
    if number in (errno.EBUSY, errno.EAGAIN) or "lock" in str(error).lower():
        return PortError(f"{name} is busy: another program holds it; end that program")
    return PortError(f"cannot open {name}: {error}; is it a serial port?")


def _group_hint(name: str) -> str:
    try:
        group = grp.getgrgid(Path(name).stat().st_gid).gr_name
    except (OSError, KeyError):
        return "ask the administrator"
    return f"it belongs to group {group}; run 'sudo usermod -aG {group} $USER' and log in again"
