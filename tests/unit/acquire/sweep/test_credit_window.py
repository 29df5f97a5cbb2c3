"""The credit window bounds what is uncommitted, and turns acks into credit."""

from __future__ import annotations

import pytest

from acquire.contract.frame_ranges import indices_of, ranges_of
from acquire.contract.messaging.messages import AckItem, Image
from acquire.sweep.credit_window import CreditWindow, slots_for


def image(frame_index: int, crc32: int = 1, role: str = "sweep") -> Image:
    return Image(frame_index=frame_index, role=role, shape=[4, 5], dtype="|u1", crc32=crc32)


def published(slots: int, *indices: int) -> CreditWindow:
    window = CreditWindow(slots)
    for index in indices:
        window.publish(image(index))
    return window


def test_credit_is_the_committed_prefix_plus_the_slots():
    window = published(3, 0, 1, 2)
    assert window.may_trigger_through() == 2
    window.commit([AckItem(0, 0, 1), AckItem(2, 0, 1)])
    assert window.may_trigger_through() == 3
    window.commit([AckItem(1, 0, 1)])
    assert window.may_trigger_through() == 5


def test_a_repeated_ack_gives_no_second_credit():
    window = published(3, 0)
    window.commit([AckItem(0, 0, 1), AckItem(0, 0, 1)])
    assert window.may_trigger_through() == 3


def test_a_frame_that_is_committed_already_is_not_waited_for():
    window = published(3, 0)
    window.commit([AckItem(0, 0, 1)])
    window.publish(image(0, crc32=2))
    assert not window.unacked and window.committed == {0: 1}


def test_an_ack_with_another_checksum_commits_nothing():
    window = published(3, 0)
    window.commit([AckItem(0, 0, 99)])
    assert window.conflicts == 1
    assert window.unacked and not window.committed


def test_frames_beside_the_sweep_take_no_credit():
    window = CreditWindow(2)
    window.publish(image(0, role="ambient"))
    window.commit([AckItem(0, 0, 1, "ambient")])
    assert window.may_trigger_through() == 1
    assert not window.unacked


def test_a_frame_that_the_writer_never_takes_is_no_longer_waited_for_and_counted():
    window = published(2, 0)
    window.refuse("sweep", 0)
    assert not window.unacked and not window.committed and window.conflicts == 1


def test_frames_that_the_file_lost_give_their_credit_back():
    window = published(4, 0, 1, 2)
    window.commit([AckItem(k, 0, 1) for k in range(3)])
    window.revoke([(1, 1)])
    assert sorted(window.committed) == [0, 2] and window.prefix == 1


def test_a_segment_gets_credit_to_the_end_of_the_window_and_more_with_each_commit():
    window = published(3, 0)
    assert window.begin(0, 9, gated=True, ahead=None) == 2
    assert window.grant(None) is None
    window.commit([AckItem(0, 0, 1)])
    assert window.grant(None) == 3


def test_after_a_hold_for_want_of_credit_the_segment_goes_on_when_half_the_window_is_free():
    window = published(4, 0, 1, 2, 3)
    window.begin(0, 9, gated=True, ahead=None)
    window.triggered_through = 3
    assert window.grant(None) is None and window.short and window.holds == 1
    window.commit([AckItem(0, 0, 1)])
    assert window.grant(None) is None and window.short
    window.commit([AckItem(1, 0, 1)])
    assert window.grant(None) == 5 and not window.short


@pytest.mark.parametrize(("ahead", "through"), [(0, -1), (1, 0), (None, 3)])
def test_no_trigger_runs_further_ahead_of_the_frames_than_pairing_can_tell_apart(ahead, through):
    assert CreditWindow(4).begin(0, 9, gated=True, ahead=ahead) == through


def test_a_check_frame_needs_no_credit():
    window = CreditWindow(2)
    assert window.begin(7, 7, gated=False, ahead=0) == 0, "its only shot"
    assert window.grant(None) is None


def test_slots_fit_into_the_bytes_or_there_are_none():
    assert slots_for(10_000_000, 1_000_000) == 10
    assert slots_for(1_500_000, 1_000_000) == 0


def test_ranges_and_indices_are_inverse():
    indices = [0, 1, 2, 5, 7, 8]
    assert ranges_of(indices) == [(0, 2), (5, 5), (7, 8)]
    assert indices_of(ranges_of(indices)) == indices
