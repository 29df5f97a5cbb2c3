"""Blocks on the line: all come back, none comes back damaged, noise costs no memory."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquire.stages.uno.framing import LONGEST_ENCODED, Block, BlockReader, decode_block, encode_block

blocks = st.builds(Block, st.integers(0, 255), st.integers(0, 255), st.binary(max_size=89))


@given(st.lists(blocks, max_size=5), st.integers(1, 7))
def test_blocks_come_back_however_the_stream_is_cut(sent, size):
    stream = b"".join(map(encode_block, sent))
    reader = BlockReader()
    got = [block for at in range(0, len(stream), size) for block in reader.feed(stream[at : at + size])]
    assert got == sent and reader.damaged == 0


@given(blocks, st.data())
def test_a_flipped_bit_never_gets_through(block, data):
    encoded = bytearray(encode_block(block)[1:-1])
    encoded[data.draw(st.integers(0, len(encoded) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    assert decode_block(bytes(encoded)) is None


@given(st.binary(max_size=2000))
def test_noise_is_thrown_away_and_the_next_block_is_heard(noise):
    reader = BlockReader()
    block = Block(1, 2, b"three")
    assert (reader.feed(noise) + reader.feed(encode_block(block)))[-1] == block


def test_a_line_without_an_end_is_not_kept():
    reader = BlockReader()
    for _ in range(100):
        reader.feed(b"x" * 1000)
    assert len(reader._rest) <= LONGEST_ENCODED
    assert reader.feed(b"\0") == [] and reader.damaged == 1


def test_a_body_that_is_too_long_is_refused():
    with pytest.raises(ValueError, match="does not fit"):
        encode_block(Block(0, 0, bytes(300)))
