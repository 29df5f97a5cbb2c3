"""Stand-ins for what people plug in instead of our controller: something on a pty that talks, echoes or is silent."""

from __future__ import annotations

import os
import select
import termios
import threading
import tty
from collections.abc import Callable
from typing import Self

Answer = Callable[[bytes, int], bytes]
"""What is answered to the bytes that came, at the baud rate (a constant of termios) that the port is set to."""


def grbl(heard: bytes, _speed: int) -> bytes:
    """GRBL 1.1 that was not reset when the port was opened: it answers lines only."""
    return b"[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n" if b"$I" in heard else b""


def old_grbl(heard: bytes, _speed: int) -> bytes:
    """GRBL that greets whatever comes."""
    return b"\r\nGrbl 0.9j ['$' for help]\r\n" if heard else b""


def marlin(heard: bytes, _speed: int) -> bytes:
    """A 3D printer's board."""
    return b"FIRMWARE_NAME:Marlin 2.0.9.3 (Dec 25 2021) PROTOCOL_VERSION:1.0\nok\n" if b"M115" in heard else b""


def boot_loader(heard: bytes, _speed: int) -> bytes:
    """An Arduino without a program: optiboot answers its sync."""
    return b"\x14\x10" if b"0 " in heard else b""


def slow_greeting(heard: bytes, speed: int) -> bytes:
    """A sketch at 9600 baud: noise at any other."""
    return b"hello, I am a thermometer\r\n" if speed == termios.B9600 else bytes((0xF8, 0x80, 0x00, 0x9E)) * 8


def noise(heard: bytes, _speed: int) -> bytes:
    """A wrong baud rate, a broken cable."""
    return bytes((0x80, 0xFE, 0x00, 0xF7, 0x91)) * 6 if heard else b""


def echo(heard: bytes, _speed: int) -> bytes:
    """A loop-back plug."""
    return heard


def silence(_heard: bytes, _speed: int) -> bytes:
    """A board without power."""
    return b""


class SerialDevice:
    """A pty that answers; ``port`` is its name. A context manager."""

    def __init__(self, answer: Answer) -> None:
        self._answer = answer
        self._ending = threading.Event()
        self._closing = threading.Lock()

    def __enter__(self) -> Self:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._thread = threading.Thread(target=self._serve, name="serial-device", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    def unplug(self) -> None:
        """Take the device away; idempotent."""
        self._ending.set()
        self._thread.join(5)
        with self._closing:  # a timer may unplug it while the test ends
            for fd in (self._master, self._slave):
                if fd >= 0:
                    os.close(fd)
            self._master = self._slave = -1

    def _serve(self) -> None:
        while not self._ending.is_set():
            if select.select([self._master], [], [], 0.02)[0]:
                heard = os.read(self._master, 4096)
                answer = self._answer(heard, termios.tcgetattr(self._slave)[4])
                if answer:
                    os.write(self._master, answer)
