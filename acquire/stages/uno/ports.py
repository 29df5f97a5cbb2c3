"""Opens the controller's serial port, or explains why it cannot be opened."""

from __future__ import annotations

import contextlib
import errno
import grp
import stat
import termios
from pathlib import Path

import serial
from serial.tools import list_ports

from acquire.contract.errors import SweepscopeError

_BY_ID = Path("/dev/serial/by-id")
STABLE_NAME = Path("/dev/sweepscope-stage")
"""What systemd/udev/70-sweepscope.rules calls the controller."""
_NO_PORTS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISREG, "a file"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
)


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
    """``wanted``, or the port that udev names as the stage's, or the only one there is.

    Raises:
        PortMissingError: nothing is named and there is none, or more than one.
    """
    if wanted:
        return wanted
    if STABLE_NAME.exists():
        return str(STABLE_NAME)
    ports = known_ports()
    if len(ports) == 1:
        return ports[0]
    tried = f"stage.port names none, {STABLE_NAME} is not there, and in /dev {_there_is(ports)}"
    raise PortMissingError(f"which serial port is the stage's? {tried}; set stage.port")


def open_port(name: str, baud: int) -> serial.Serial:
    """Open the port for ourselves alone, raw, without waiting reads.

    Raises:
        PortError: no such port, busy, no permission, or not a serial port; the text says which and what to do.
    """
    _check_kind(name)
    try:
        port = serial.Serial(name, baud, timeout=0, write_timeout=0, exclusive=True)
    except serial.SerialException as error:
        raise _in_words(name, error) from None
    except (OSError, ValueError, termios.error) as error:
        raise _no_port(name, str(error)) from None
    _keep_dtr(port)
    return port


def _check_kind(name: str) -> None:
    try:
        mode = Path(name).stat().st_mode
    except (OSError, ValueError):
        return  # the attempt to open it says more
    for is_kind, kind in _NO_PORTS:
        if is_kind(mode):
            raise _no_port(name, f"it is {kind}")


def _no_port(name: str, why: str) -> PortError:
    return PortError(f"{name} is no serial port: {why}; {_there_is(known_ports())}; set stage.port")


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
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.ENOTDIR, errno.ENAMETOOLONG):
        return PortMissingError(f"no serial port {name}; {_there_is(known_ports())}")
    if number in (errno.EACCES, errno.EPERM):
        return PortError(f"no permission for {name}: {_group_hint(name)}")
    if number in (errno.EBUSY, errno.EAGAIN) or "lock" in str(error).lower():
        return PortError(f"{name} is busy: another program holds it; end that program")
    return _no_port(name, str(error))


def _group_hint(name: str) -> str:
    try:
        group = grp.getgrgid(Path(name).stat().st_gid).gr_name
    except (OSError, KeyError):
        return "ask the administrator"
    return f"it belongs to group {group}; run 'sudo usermod -aG {group} $USER' and log in again"
