"""The window bounds what is uncommitted, and turns acks into credit."""

from __future__ import annotations

import numpy as np

from acquire.contract.frame_ranges import indices_of, ranges_of
from acquire.contract.messaging.messages import AckItem, Image
from acquire.sweep.credit_window import Window, slots_for

PIXELS = np.zeros((4, 5), np.uint8)


def image(frame_index: int, crc32: int = 1, role: str = "sweep") -> Image:
    return Image(frame_index=frame_index, role=role, shape=[4, 5], dtype="|u1", crc32=crc32)


def test_credit_is_the_committed_prefix_plus_the_slots():
    window = Window(3)
    assert window.may_trigger_through() == 2
    for index in (0, 2):
        window.keep(image(index), PIXELS)
        window.commit(AckItem(index, 0, 1))
    assert window.may_trigger_through() == 3
    window.commit(AckItem(1, 0, 1))
    assert window.may_trigger_through() == 5


def test_a_repeated_ack_gives_no_second_credit():
    window = Window(3)
    window.keep(image(0), PIXELS)
    assert window.commit(AckItem(0, 0, 1))
    assert not window.commit(AckItem(0, 0, 1))
    assert window.may_trigger_through() == 3


def test_a_committed_frame_is_not_sent_again():
    window = Window(3)
    window.keep(image(0), PIXELS)
    window.commit(AckItem(0, 0, 1))
    assert not window.keep(image(0, crc32=2), PIXELS)


def test_an_ack_with_another_checksum_commits_nothing():
    window = Window(3)
    window.keep(image(0, crc32=1), PIXELS)
    assert not window.commit(AckItem(0, 0, 99))
    assert window.conflicts == 1
    assert not window.is_settled()


def test_frames_beside_the_sweep_take_no_credit():
    window = Window(2)
    window.keep(image(0, role="ambient"), PIXELS)
    window.commit(AckItem(0, 0, 1, "ambient"))
    assert window.may_trigger_through() == 1
    assert window.is_settled()


def test_kept_bytes_are_those_of_the_pixels():
    window = Window(2)
    window.keep(image(0), PIXELS)
    assert window.kept_bytes() == PIXELS.nbytes


def test_slots_fit_into_the_bytes_or_there_are_none():
    assert slots_for(10_000_000, 1_000_000) == 10
    assert slots_for(1_500_000, 1_000_000) == 0


def test_ranges_and_indices_are_inverse():
    indices = [0, 1, 2, 5, 7, 8]
    assert ranges_of(indices) == [(0, 2), (5, 5), (7, 8)]
    assert indices_of(ranges_of(indices)) == indices
