"""What several lanes carry at once: one frame, whole on each of them, and let go of when all have sent it."""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq
from zmq.utils import garbage

from acquire.contract.messaging.lanes import Received, Sender, bind, connect, receive, shared
from acquire.contract.messaging.messages import Hello
from tests.waiting import wait_for

LANES = ("frames", "live")


@pytest.fixture
def ends(run_dir: Path) -> Iterator[list[tuple[Sender, zmq.Socket[Any]]]]:
    """A sender and a receiver on each lane."""
    context: zmq.Context[Any] = zmq.Context()
    made = [
        (Sender(bind(context, zmq.PAIR, run_dir, lane)), connect(context, zmq.PAIR, run_dir, lane)) for lane in LANES
    ]
    yield made
    for sender, socket in made:
        sender.socket.close(0)
        socket.close(0)
    context.term()
    garbage.gc.stop()  # the thread that lets go of what was sent


def arrived(socket: zmq.Socket[Any]) -> Received:
    wait_for(lambda: socket.poll(200), "a message")
    found = receive(socket)
    assert found is not None and found.payload is not None
    return found


def test_a_frame_that_two_lanes_share_arrives_whole_on_both_and_is_let_go(ends):
    pixels = np.arange(90_000, dtype=np.uint16).reshape(300, 300)
    expected, gone = pixels.tobytes(), weakref.ref(pixels)
    part = shared(pixels)
    for sender, _ in ends:
        wait_for(lambda sender=sender: sender.socket.poll(200, zmq.POLLOUT), "room")
        assert sender.send(Hello(pid=1), part)
    assert [arrived(socket).payload.bytes for _, socket in ends] == [expected] * len(ends)
    del pixels, part
    wait_for(lambda: gone() is None, "nobody holds the frame")
