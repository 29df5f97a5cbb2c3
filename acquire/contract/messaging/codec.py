"""Bytes to structs and back: bounded, typed, no pickle. Bytes that are no message raise ProtocolError."""

from __future__ import annotations

from typing import Final, NoReturn, TypeVar

import msgspec

from acquire.contract.errors import ProtocolError

from .messages import PROTOCOL, AnyMessage, Message

MAX_HEADER_BYTES: Final = 16 * 1024 * 1024
"""A longer header is refused unread (the largest that is sent contains configuration and calibration)."""

MALFORMED: Final = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError, OverflowError)
"""What msgspec raises for hostile bytes: bad MessagePack or values, bad UTF-8, deep nesting, huge numbers."""

M = TypeVar("M", bound=Message)


class ProtocolMismatchError(ProtocolError):
    """The other side speaks another major version."""


class _Head(msgspec.Struct, frozen=True):
    """What every header must contain; read first, so that a refusal can name the kind and the version."""

    type: str
    protocol: tuple[int, int]


def _refuse_extension(code: int, _data: memoryview) -> NoReturn:
    raise msgspec.ValidationError(f"MessagePack extension {code}: no message has one")


_ENCODER: Final = msgspec.msgpack.Encoder()
_HEAD: Final = msgspec.msgpack.Decoder(_Head)
_MESSAGE: Final[msgspec.msgpack.Decoder[Message]] = msgspec.msgpack.Decoder(AnyMessage, ext_hook=_refuse_extension)


def encode(message: Message) -> bytes:
    """MessagePack bytes of a message.

    Raises:
        ProtocolError: a text in it holds a byte that is not UTF-8, as file names of other systems do, or a number
            has more than 64 bits.
    """
    try:
        return _ENCODER.encode(message)
    except UnicodeEncodeError as error:
        raise ProtocolError(f"'{error.object[:120]}' holds a byte that is not UTF-8: rename it") from None
    except OverflowError:
        raise ProtocolError("a number has more than 64 bits: give a smaller one") from None


def decode(header: bytes | memoryview) -> Message:
    """The message in ``header``.

    Raises:
        ProtocolMismatchError: another major version; both are named.
        ProtocolError: not MessagePack, too long or too deep, an unknown type, a field missing or out of bounds.
    """
    if len(header) > MAX_HEADER_BYTES:
        raise ProtocolError(f"header of {len(header)} bytes is over the bound of {MAX_HEADER_BYTES}")
    try:
        head = _HEAD.decode(header)
    except MALFORMED as error:
        raise ProtocolError(f"not a message: {type(error).__name__} {str(error)[:120]}") from None
    if head.protocol[0] != PROTOCOL[0]:
        raise ProtocolMismatchError(
            f"the sender speaks protocol {head.protocol[0]}.{head.protocol[1]}, this process "
            f"{PROTOCOL[0]}.{PROTOCOL[1]}: restart both with the same version"
        )
    try:
        return _MESSAGE.decode(header)
    except MALFORMED as error:
        raise ProtocolError(f"{head.type[:40]}: {str(error)[:200]}") from None


def decode_as(header: bytes | memoryview, *kinds: type[M]) -> M:
    """Like :func:`decode`, and of one of ``kinds``, else ProtocolError."""
    message = decode(header)
    if not isinstance(message, kinds):
        raise ProtocolError(f"a {type(message).__name__} does not belong on this lane")
    return message
