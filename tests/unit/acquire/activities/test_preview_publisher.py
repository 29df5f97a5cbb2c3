"""The preview lane: no work without subscribers, few pictures during a sweep, the newest one wins."""

from __future__ import annotations

import numpy as np
import pytest
import zmq

from acquire.activities.images import PreviewFrame
from acquire.activities.preview_publisher import PreviewPublisher
from acquire.contract.messaging.lanes import bind, connect, receive
from acquire.contract.messaging.messages import FrameFormat, Picture
from tests.waiting import wait_for

FORM = FrameFormat(width=64, height=48, bit_depth=8)
SECOND = 1_000_000_000


@pytest.fixture
def lane(run_dir):
    context = zmq.Context()
    found = PreviewPublisher(bind(context, zmq.XPUB, run_dir, "preview"))
    found.join = lambda kind=zmq.SUB: connect(context, kind, run_dir, "preview")
    yield found
    context.destroy(linger=0)


def view(frame_index):
    return PreviewFrame(
        np.full((48, 64), frame_index, np.uint8), 3 * frame_index, 9.5 * frame_index, 30.0, frame_index, "uid"
    )


def until(lane, watched):
    wait_for(lambda: lane.watched == watched, f"watched: {watched}", pause=lane.poll)


def next_picture(socket):
    assert socket.poll(10_000)
    received = receive(socket)
    assert isinstance(received.message, Picture)
    return received


def test_of_a_sweeps_frames_the_newest_is_shown_at_most_five_times_a_second(lane):
    watcher = lane.join()
    until(lane, watched=True)
    for millisecond in range(0, 1000, 10):
        lane.keep(view(millisecond // 10))
        lane.flush(SECOND + millisecond * 1_000_000, FORM, rate_hz=30)
    assert lane.counters["pictures"] == 5
    first = next_picture(watcher)
    assert first.message.frame_index == 0 and first.message.scan_uid == "uid" and first.message.shape == [48, 64]
    second = next_picture(watcher)
    assert second.message.frame_index == 20 and bytes(second.payload.buffer) == bytes([20]) * 48 * 64
    watcher.close()


def test_without_subscribers_nothing_is_kept_or_made(lane):
    lane.keep(view(1))
    watcher = lane.join()
    until(lane, watched=True)
    lane.flush(SECOND, FORM, 5)
    assert lane.counters["pictures"] == 0
    watcher.close()
    until(lane, watched=False)
    lane.show(view(2), FORM)
    assert lane.counters["pictures"] == 0


def test_words_that_are_no_subscription_change_nothing(lane):
    stranger = lane.join(zmq.XSUB)
    for word in (b"", b"\x01topic", b"\x02", b"\x00", b"x" * 1000):
        stranger.send(word)
    watcher = lane.join()
    until(lane, watched=True)
    lane.show(view(7), FORM)
    assert next_picture(watcher).message.frame_index == 7
    for socket in (stranger, watcher):
        socket.close()
