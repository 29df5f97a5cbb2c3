"""What a rig tells of itself, as every client reads it."""

from __future__ import annotations

import numpy as np
import pytest
import zmq

from acquire.contract.errors import ConfigError, ProtocolError
from acquire.contract.messaging.lanes import Sender, bind
from acquire.contract.messaging.messages import Picture, Status
from acquire.contract.rig_client.feed import RigFeed, picture_pixels


def header(*shape: int) -> Picture:
    return Picture(shape=list(shape), source_shape=[3, 4])


@pytest.mark.parametrize("shape", [(3, 4), (3, 4, 3)])
def test_pixels_of_a_picture_have_the_shape_of_its_header(shape) -> None:
    pixels = np.arange(np.prod(shape), dtype=np.uint8).reshape(shape)
    assert np.array_equal(picture_pixels(header(*shape), pixels.tobytes()), pixels)


@pytest.mark.parametrize(("shape", "nbytes"), [((3, 4), 11), ((3, 4), 0), ((3, 4, 2), 24), ((3, 4), 36)])
def test_a_picture_that_does_not_fit_its_header_is_refused(shape, nbytes) -> None:
    with pytest.raises(ProtocolError, match=f"{nbytes} bytes"):
        picture_pixels(header(*shape), bytes(nbytes))


def test_an_unreadable_message_is_counted_and_the_next_one_read(run_dir) -> None:
    context = zmq.Context()
    try:
        rig = Sender(bind(context, zmq.XPUB, run_dir, "status"))
        feed = RigFeed(context, "status")
        feed.connect(run_dir)
        assert rig.socket.poll(5000), "nobody subscribed"
        rig.socket.recv()
        other = Status(state="idle", protocol=(9, 0))
        rig.socket.send(b"\xc1 rubbish")
        rig.send(other)
        rig.send(Status(state="homing"))
        heard = []
        while not heard and feed.sockets["status"].poll(5000):
            heard += [received.message.state for received in feed.arrived("status", 10)]
        assert (heard, feed.unreadable) == (["homing"], 2)
    finally:
        context.destroy(linger=0)


def test_camera_pictures_are_asked_for_only_while_they_are_wanted(run_dir) -> None:
    context = zmq.Context()
    try:
        rig = bind(context, zmq.XPUB, run_dir, "preview")
        feed = RigFeed(context, "preview")
        feed.connect(run_dir)
        assert not rig.poll(100), "nothing was asked for yet"
        for wanted in (True, False):
            feed.want_pictures(wanted)
            feed.want_pictures(wanted)
            assert rig.poll(5000)
            assert rig.recv() == bytes([wanted])
            assert not rig.poll(50), "asked once only"
    finally:
        context.destroy(linger=0)


def test_a_run_directory_that_is_too_deep_for_sockets_is_said(tmp_path) -> None:
    context = zmq.Context()
    try:
        feed = RigFeed(context)
        with pytest.raises(ConfigError, match="longer than"):
            feed.connect(tmp_path / ("x" * 120))
    finally:
        context.destroy(linger=0)
