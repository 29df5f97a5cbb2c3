"""What else than our firmware is at a serial port, in words: from what it says by itself, or when asked politely."""

from __future__ import annotations

import re
import time
from typing import Final

import serial

from .serial_io import read_now, wait_readable, write_now

LOOK_S: Final = 2.5
"""How long :func:`ask_around` takes at most."""
_SPEEDS_BAUD: Final = (250_000, 115_200, 57_600, 9600)
"""Ours, GRBL's and Marlin's, that of old boot loaders, and that of most examples."""
_ANSWER_S: Final = 0.5
_MOST_BYTES: Final = 4096
_QUESTIONS: Final = b"0 0 \r\n$I\r\n?\r\nM115\r\n"
"""Sync of a boot loader, version and state of GRBL, name of Marlin and its kin. None of them moves anything."""
_SLOW_QUESTION: Final = b"\r\n"
"""At 9600 baud the original sketch may listen, to which digits are steps."""
_SLOW_BAUD: Final = 9600

_KNOWN: Final = (
    (re.compile(rb"Grbl (\d[\w.]*)"), "GRBL {}"),
    (re.compile(rb"\[VER:(\d\.\d\w?)"), "GRBL {}"),
    (re.compile(rb"(?i)grbl|\[OPT:|<(?:Idle|Alarm|Run|Hold|Jog|Home)[|,>]"), "GRBL"),
    (re.compile(rb"FIRMWARE_NAME: ?([\w.\-]+(?: [\d.]+\w*)?)"), "{}"),
    (re.compile(rb"Marlin(?: (?:bugfix-)?([\d.x]+))?"), "Marlin {}"),
    (re.compile(rb"(?i)smoothie"), "Smoothieware"),
    (re.compile(rb"(?i)repetier"), "Repetier"),
    (re.compile(rb"(?i)klipper"), "Klipper"),
    (re.compile(rb"MicroPython|CircuitPython|>>> "), "MicroPython"),
    (re.compile(rb"\bets \w{3} |rst:0x|ESP-ROM"), "an ESP32 board"),
    (re.compile(rb"login: ?$|Password: ?$"), "the console of a computer"),
    (re.compile(rb"\x14\x10"), "the boot loader of an Arduino without a program"),
)


def ask_around(port: serial.Serial) -> tuple[bytes, int]:
    """Ask at the usual speeds until somebody answers in words; returns what was heard last, and its baud rate."""
    heard, at_baud = b"", int(port.baudrate)
    for baud in _SPEEDS_BAUD:
        port.baudrate = baud
        write_now(port, _SLOW_QUESTION if baud == _SLOW_BAUD else _QUESTIONS)
        found = _listen(port)
        if _clarity(found) > _clarity(heard):
            heard, at_baud = found, baud
        if is_known(found):
            break
    return heard, at_baud


def is_known(heard: bytes) -> bool:
    """True if :func:`words_for` can name who said this."""
    return any(pattern.search(heard) for pattern, _ in _KNOWN)


def words_for(heard: bytes, sent: bytes = b"") -> str:
    """Who said ``heard`` after we had sent ``sent``; empty for silence."""
    for pattern, name in _KNOWN:
        if found := pattern.search(heard):
            details = [group.decode("ascii", "replace") for group in found.groups() if group]
            return name.format(*details or ("",)).strip()
    if (sent and sent in heard) or _QUESTIONS in heard:
        return "an echo of what is sent (a loop-back plug, or a port that another program answers)"
    if not heard:
        return ""
    line = _readable_line(heard)
    return f"something that says {line!r}" if line else "noise (another baud rate, or no controller at all)"


def _clarity(heard: bytes) -> int:
    return 3 if is_known(heard) else 2 if _readable_line(heard) else 1 if heard else 0


def _listen(port: serial.Serial) -> bytes:
    heard = b""
    end_s = time.monotonic() + _ANSWER_S
    while (left_s := end_s - time.monotonic()) > 0 and len(heard) < _MOST_BYTES:
        wait_readable(left_s, port.fileno())
        heard += read_now(port)
    return heard


def _readable_line(heard: bytes) -> str:
    """The first line, where nearly all of it is text; else nothing."""
    readable = sum(0x20 <= byte < 0x7F or byte in b"\r\n\t" for byte in heard)
    if readable < 0.9 * len(heard):
        return ""
    lines = [line.strip() for line in heard.decode("ascii", "replace").splitlines()]
    return next((line[:60] for line in lines if line), "")
