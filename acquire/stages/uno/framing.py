"""Framing of the serial protocol: COBS blocks of length, sequence, type, body and CRC-32; damaged blocks are dropped.

Pure: bytes in, blocks out. Source: firmware/protocol.h.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from cobs import cobs

BLOCK_OVERHEAD = 7
"""Bytes of a block besides its body: length, sequence, type, crc32."""
LONGEST_ENCODED = 254
"""A longer run without a zero is noise (the format's blocks are below 104 bytes)."""


@dataclass(frozen=True)
class Block:
    """One valid block."""

    sequence: int
    """0..255; that of the command it carries or answers."""
    kind: int
    body: bytes


def encode_block(block: Block) -> bytes:
    """Bytes for the wire, between two zeros: the first one ends whatever noise came before."""
    if len(block.body) > LONGEST_ENCODED - 2 * BLOCK_OVERHEAD:
        raise ValueError(f"a body of {len(block.body)} bytes does not fit into a block")
    raw = bytes((len(block.body), block.sequence, block.kind)) + block.body
    encoded: bytes = cobs.encode(raw + struct.pack("<I", zlib.crc32(raw)))
    return b"\0" + encoded + b"\0"


def decode_block(encoded: bytes) -> Block | None:
    """The block between two zeros, or None if it is damaged."""
    try:
        raw = cobs.decode(encoded)
    except cobs.DecodeError:
        return None
    if len(raw) < BLOCK_OVERHEAD or raw[0] != len(raw) - BLOCK_OVERHEAD:
        return None
    if zlib.crc32(raw[:-4]) != int.from_bytes(raw[-4:], "little"):
        return None
    return Block(sequence=raw[1], kind=raw[2], body=raw[3:-4])


class BlockReader:
    """Cuts a stream of bytes into valid blocks and counts the damaged ones; memory is bounded."""

    def __init__(self) -> None:
        self._rest = bytearray()
        self._too_long = False
        self.damaged = 0
        """Blocks that were thrown away."""

    def feed(self, data: bytes) -> list[Block]:
        """The valid blocks that end within ``data``."""
        self._rest += data
        *ended, rest = bytes(self._rest).split(b"\0")
        found = [block for encoded in ended if (block := self._take(encoded)) is not None]
        self._too_long = self._too_long or len(rest) > LONGEST_ENCODED
        self._rest = bytearray() if self._too_long else bytearray(rest)
        return found

    def _take(self, encoded: bytes) -> Block | None:
        if not encoded and not self._too_long:
            return None
        block = None if self._too_long else decode_block(encoded)
        self._too_long = False
        self.damaged += block is None
        return block
