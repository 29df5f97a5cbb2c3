"""Bytes to structs and back: bounded, typed, no pickle; whatever cannot be decoded raises one error class."""

from __future__ import annotations

from typing import Any, Final, TypeVar

import msgpack
import msgspec

from acquire.contract.errors import ProtocolError

from .messages import (
    PROTOCOL,
    Ack,
    Command,
    End,
    EndAck,
    Hello,
    Image,
    Message,
    Nack,
    Picture,
    Reply,
    ResultEnd,
    ResultMaps,
    ResultProgress,
    ResultTiles,
    Start,
    StartAck,
    Status,
)

MAX_HEADER_BYTES: Final = 16 * 1024 * 1024
"""A header that is longer is refused unread (the largest honest one carries configuration and calibration)."""

_TYPES: Final[dict[str, type[Message]]] = {
    "start": Start,
    "image": Image,
    "end": End,
    "hello": Hello,
    "start_ack": StartAck,
    "ack": Ack,
    "end_ack": EndAck,
    "nack": Nack,
    "status": Status,
    "command": Command,
    "reply": Reply,
    "result_progress": ResultProgress,
    "result_tiles": ResultTiles,
    "result_maps": ResultMaps,
    "picture": Picture,
    "result_end": ResultEnd,
}

_ENCODER: Final = msgspec.msgpack.Encoder()
_IMAGE: Final = msgspec.msgpack.Decoder(Image)
_IMAGE_BEGINS: Final = b"\xa4type\xa5image\xa8protocol"
_AFTER_SIZE: Final = slice(3, 3 + len(_IMAGE_BEGINS))
"""Behind the size of the map: where the encoder puts type and version of an image."""

M = TypeVar("M", bound=Message)


class ProtocolMismatchError(ProtocolError):
    """The other side speaks another major version."""


def encode(message: Message) -> bytes:
    """MessagePack bytes of a message."""
    return _ENCODER.encode(message)


def decode(header: bytes | memoryview) -> Message:
    """The message in ``header``.

    Raises:
        ProtocolMismatchError: another major version; both are named.
        ProtocolError: not MessagePack, too long or too deep, an unknown type, a field missing or out of bounds.
    """
    # one message per frame is worth a shorter way; whatever it does not take is refused in words below
    image = _image(header)
    if image is not None:
        return image
    fields = _unpack(header)
    _check_protocol(fields.get("protocol"))
    struct = _TYPES.get(fields["type"]) if isinstance(fields.get("type"), str) else None
    if struct is None:
        raise ProtocolError(f"unknown message type {str(fields.get('type'))[:40]!r}")
    try:
        return msgspec.convert(fields, struct, strict=True)
    except (msgspec.ValidationError, RecursionError, OverflowError) as error:
        raise ProtocolError(f"{fields['type']}: {str(error)[:200]}") from None


def decode_as(header: bytes | memoryview, *kinds: type[M]) -> M:
    """Like :func:`decode`, and of one of ``kinds``, else ProtocolError."""
    message = decode(header)
    if not isinstance(message, kinds):
        raise ProtocolError(f"a {type(message).__name__} does not belong on this lane")
    return message


def _image(header: bytes | memoryview) -> Image | None:
    """The image in ``header``, read without a detour through a dictionary; None if it is anything else or unsound."""
    if len(header) > MAX_HEADER_BYTES or bytes(header[_AFTER_SIZE]) != _IMAGE_BEGINS:
        return None
    try:
        image = _IMAGE.decode(header)
    except (msgspec.MsgspecError, ValueError, RecursionError, OverflowError):
        return None
    return image if image.protocol[0] == PROTOCOL[0] else None


def _unpack(header: bytes | memoryview) -> dict[str, Any]:
    if len(header) > MAX_HEADER_BYTES:
        raise ProtocolError(f"header of {len(header)} bytes is over the bound of {MAX_HEADER_BYTES}")
    size = len(header)
    try:
        fields = msgpack.unpackb(
            header,
            raw=False,
            strict_map_key=True,
            max_str_len=size,
            max_bin_len=size,
            max_array_len=min(size, 1_000_000),
            max_map_len=min(size, 10_000),
            max_ext_len=0,
        )
    except (ValueError, TypeError, msgpack.UnpackException, RecursionError, OverflowError) as error:
        # bad UTF-8 raises UnicodeDecodeError (a ValueError), deep nesting StackError or RecursionError
        raise ProtocolError(f"not a message: {type(error).__name__} {str(error)[:120]}") from None
    if not isinstance(fields, dict):
        raise ProtocolError("not a message: the header is no map")
    return fields


def _check_protocol(protocol: object) -> None:
    if not (
        isinstance(protocol, (list, tuple)) and len(protocol) == 2 and all(isinstance(part, int) for part in protocol)
    ):
        raise ProtocolError("the header has no protocol version")
    if protocol[0] != PROTOCOL[0]:
        raise ProtocolMismatchError(
            f"the sender speaks protocol {protocol[0]}.{protocol[1]}, this process {PROTOCOL[0]}.{PROTOCOL[1]}: "
            "restart both with the same version"
        )
