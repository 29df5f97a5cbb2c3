"""Handshake with the firmware: protocol version and checksum of the declarations must match before anything is sent."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from typing import Final

import serial

from acquire.contract.errors import SweepscopeError
from acquire.stages.uno.framing import Block, BlockReader, encode_block

from .identify import ask_around, is_known, words_for
from .serial_io import LinkLostError, read_now, wait_readable, write_now
from .wire_format import LINK_BAUD, PROTOCOL_MAJOR, PROTOCOL_MINOR, WIRE_CRC, Cmd, HelloBody, HelloReplyBody, Msg

_HELLO_AGAIN_S: Final = 0.1
_MOST_HEARD: Final = 4096


class FirmwareMismatchError(SweepscopeError):
    """Another firmware, or another version of ours, answers."""


def new_nonce() -> int:
    """Random id of a new session; never 0, which means none."""
    return secrets.randbelow(0xFFFF_FFFF) + 1


def shake_hands(
    port: serial.Serial,
    reader: BlockReader,
    nonce: int,
    within_s: float,
    given_up: Callable[[], bool],
    *,
    is_new: bool = False,
) -> HelloReplyBody:
    """Send HELLO until the firmware answers.

    ``is_new``: the port was never our firmware's, so that it is worth finding out who else is there.

    Raises:
        LinkLostError: nothing answers ``within_s``, or ``given_up`` returns True.
        FirmwareMismatchError: another firmware answers.
    """
    deadline_s = time.monotonic() + within_s
    hello = encode_block(Block(0, Cmd.HELLO, HelloBody(PROTOCOL_MAJOR, PROTOCOL_MINOR, nonce).pack()))
    heard = b""
    while time.monotonic() < deadline_s and not given_up():
        write_now(port, hello)
        again_s = time.monotonic() + _HELLO_AGAIN_S
        while (now_s := time.monotonic()) < again_s and not given_up():
            wait_readable(again_s - now_s, port.fileno())
            data = read_now(port)
            heard = (heard + data)[:_MOST_HEARD]
            for block in reader.feed(data):
                if block.kind == Msg.HELLO:
                    return _ours(HelloReplyBody.unpack(block.body))
    baud = int(port.baudrate)
    if is_new and not is_known(heard) and not given_up():
        answered, baud = ask_around(port)
        heard = answered or heard
    raise _nobody(str(port.name), heard, hello, baud)


def _ours(hello: HelloReplyBody) -> HelloReplyBody:
    if hello.major != PROTOCOL_MAJOR:
        raise FirmwareMismatchError(
            f"the firmware speaks protocol {hello.major}.{hello.minor}, this program {PROTOCOL_MAJOR}."
            f"{PROTOCOL_MINOR}: nothing has moved; flash the firmware of this version (make -C firmware flash)"
        )
    if hello.wire_crc != WIRE_CRC:
        raise FirmwareMismatchError(
            f"the firmware was built from other declarations ({hello.wire_crc:08x}) than this program "
            f"({WIRE_CRC:08x}): nothing has moved; flash the firmware of this version (make -C firmware flash)"
        )
    return hello


def _nobody(name: str, heard: bytes, hello: bytes, baud: int) -> SweepscopeError:
    if who := words_for(heard, hello):
        speed = "" if baud == LINK_BAUD else f" at {baud} baud"
        return FirmwareMismatchError(
            f"on the stage's port {name} there is {who}{speed}, not our firmware: nothing has moved; "
            f"flash ours (make -C firmware flash PORT={name}), or name another port in stage.port"
        )
    return LinkLostError(
        f"nothing answers on the stage's port {name}: is the controller powered, is it the right port, is our firmware "
        f"on it (make -C firmware flash PORT={name})?"
    )
