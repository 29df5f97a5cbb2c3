"""The source's end of the lossless lane, over real sockets, with a writer made of a few lines."""

from __future__ import annotations

import time

import numpy as np
import pytest
import zmq

from acquire.contract.messaging.lanes import Sender, bind, connect, receive
from acquire.contract.messaging.messages import (
    Ack,
    AckItem,
    End,
    EndAck,
    FrameFormat,
    Hello,
    Image,
    Nack,
    Start,
    StartAck,
)
from acquire.contract.plan import SweepPlan
from acquire.contract.scan_data.checksums import frame_crc32
from acquire.contract.states import Outcome
from acquire.daemon.frame_sender import FrameSender
from acquire.sweep.events import Committed, Refused, Sealed, WriterReady
from tests.waiting import wait_for

PLAN = SweepPlan(first_steps=0, last_steps=30, steps_per_frame=3, um_per_microstep=3.175)
START = Start(scan_uid="u", path="/x", format=FrameFormat(width=5, height=4, bit_depth=8), plan=PLAN)


def frame(index):
    pixels = np.full((4, 5), index, np.uint8)
    image = Image(scan_uid="u", frame_index=index, shape=[4, 5], dtype="|u1", crc32=frame_crc32(pixels))
    return image, pixels


class TinyWriter:
    """Speaks the writer's side by hand, so that each message is the test's decision."""

    def __init__(self, context, run_dir):
        self.socket = connect(context, zmq.DEALER, run_dir, "frames")
        self.sender = Sender(self.socket)

    def send(self, message):
        assert self.sender.send(message)

    def take(self):
        wait_for(lambda: self.socket.poll(200), "a message")
        return receive(self.socket)

    def nothing(self):
        return not self.socket.poll(100)


@pytest.fixture
def context():
    found = zmq.Context()
    yield found
    found.destroy(linger=0)


@pytest.fixture
def lane(context, run_dir):
    return FrameSender(bind(context, zmq.ROUTER, run_dir, "frames"))


@pytest.fixture
def writer(context, run_dir, lane):
    return TinyWriter(context, run_dir)


@pytest.fixture
def second(context, run_dir, lane):
    return TinyWriter(context, run_dir)


def poll(lane, wanted=1):
    events = []

    def enough():
        lane.socket.poll(50)
        events.extend(lane.poll(time.monotonic_ns()))
        return len(events) >= wanted

    wait_for(enough, f"{wanted} events", pause=lambda: None, why=lambda: events)
    return events


def make_ready(lane, writer, committed=(), crc32=()):
    writer.send(Hello())
    lane.begin(START)
    _until(lane, lambda: lane.alive(time.monotonic_ns(), 10**10))
    assert isinstance(writer.take().message, Start)
    writer.send(StartAck(scan_uid="u", path="/x", committed=list(committed), crc32=list(crc32)))
    return poll(lane)


def answer(lane, writer, committed=(), crc32=()):
    """A writer says hello in mid-sweep and takes the scan on."""
    writer.send(Hello())
    _until(lane, lambda: writer.socket.poll(10))
    assert isinstance(writer.take().message, Start)
    writer.send(StartAck(scan_uid="u", path="/x", committed=list(committed), crc32=list(crc32)))
    return poll(lane)


def _until(lane, condition):
    def pause():
        lane.socket.poll(20)
        lane.poll(time.monotonic_ns())

    wait_for(condition, "the lane's state", pause=pause)


def test_frames_wait_until_the_writer_is_ready_and_then_come_in_order(lane, writer):
    lane.begin(START)
    for index in range(3):
        lane.offer(*frame(index))
    assert answer(lane, writer) == [WriterReady(True, False)]
    assert [writer.take().message.frame_index for _ in range(3)] == [0, 1, 2]


def test_an_acked_frame_is_let_go_and_the_others_are_kept(lane, writer):
    make_ready(lane, writer)
    for index in range(3):
        lane.offer(*frame(index))
    writer.send(Ack(scan_uid="u", frames=[AckItem(0, 0, frame(0)[0].crc32)], committed_count=1, durable_count=0))
    assert poll(lane) == [Committed((AckItem(0, 0, frame(0)[0].crc32),), 0)]
    assert sorted(key[1] for key in lane.unacked) == [1, 2]


def test_an_ack_for_a_frame_that_was_never_sent_commits_nothing(lane, writer):
    make_ready(lane, writer)
    writer.send(Ack(scan_uid="u", frames=[AckItem(0, 0, 7)], committed_count=1, durable_count=0))
    assert poll(lane) == [Committed((), 0)]
    assert lane.counters["stray_acks"] == 1


def test_a_frame_that_the_writer_has_with_other_pixels_is_kept(lane, writer):
    make_ready(lane, writer)
    lane.offer(*frame(0))
    writer.send(Ack(scan_uid="u", frames=[AckItem(0, 0, 7)], committed_count=1, durable_count=0))
    assert poll(lane) == [Committed((AckItem(0, 0, 7),), 0)]
    assert lane.unacked


def test_a_writer_that_comes_back_gets_what_it_has_not_committed(lane, writer, second):
    make_ready(lane, writer)
    for index in range(3):
        lane.offer(*frame(index))
    assert answer(lane, second, [(0, 0)], [frame(0)[0].crc32]) == [
        WriterReady(True, True, (AckItem(0, 0, frame(0)[0].crc32),))
    ]
    received = [second.take() for _ in range(2)]
    assert [r.message.frame_index for r in received] == [1, 2]
    assert [r.payload.bytes for r in received] == [frame(k)[1].tobytes() for k in (1, 2)]


def test_the_writer_that_was_replaced_is_told_so_and_gets_nothing_more(lane, writer, second):
    make_ready(lane, writer)
    answer(lane, second)
    writer.send(Ack(scan_uid="u", frames=[], committed_count=0, durable_count=0))
    _until(lane, lambda: lane.counters["superseded"] == 1)
    assert writer.take().message.reason == "superseded"
    lane.offer(*frame(0))
    assert second.take().message.frame_index == 0
    assert writer.nothing()


def test_a_refused_frame_is_kept_and_sent_again_later(lane, writer):
    make_ready(lane, writer)
    lane.offer(*frame(0))
    writer.take()
    writer.send(Nack(scan_uid="u", reason="no space", frame_index=0))
    (event,) = poll(lane)
    assert isinstance(event, Refused) and lane.unacked
    lane.poll(time.monotonic_ns() + 2 * 10**9)
    assert writer.take().message.frame_index == 0


def test_the_end_is_said_again_to_a_writer_that_comes_back(lane, writer, second):
    make_ready(lane, writer)
    lane.finish(End(scan_uid="u", outcome=Outcome.COMPLETE, expected=0, sent=0))
    answer(lane, second)
    assert isinstance(second.take().message, End)
    second.send(EndAck(scan_uid="u", path="/x", sealed=True, outcome=Outcome.COMPLETE, committed=0))
    (event,) = poll(lane)
    assert isinstance(event, Sealed)


def test_words_of_another_scan_are_ignored(lane, writer):
    make_ready(lane, writer)
    lane.offer(*frame(0))
    writer.send(Ack(scan_uid="other", frames=[AckItem(0, 0, 1)], committed_count=1, durable_count=1))
    writer.send(Ack(scan_uid="u", frames=[], committed_count=0, durable_count=0))
    assert poll(lane) == [Committed((), 0)]
    assert lane.unacked


def test_garbage_is_counted_and_does_no_harm(lane, writer):
    writer.socket.send_multipart([b"\xc1garbage"])
    writer.socket.send_multipart([b"a", b"b", b"c", b"d"])
    _until(lane, lambda: lane.counters["malformed"] == 2)
    assert make_ready(lane, writer) == [WriterReady(True, False)]


def test_a_frame_that_the_file_holds_in_another_version_is_given_up(lane, writer):
    make_ready(lane, writer)
    lane.offer(*frame(0))
    writer.send(Nack(scan_uid="u", reason="immutable", frame_index=0))
    poll(lane)
    assert not lane.unacked


def test_a_writer_that_lost_the_scan_is_told_of_it_again(lane, writer):
    make_ready(lane, writer)
    lane.offer(*frame(0))
    writer.take()
    writer.send(Nack(scan_uid="u", reason="no such scan", frame_index=0))
    poll(lane)
    assert isinstance(writer.take().message, Start)
    writer.send(StartAck(scan_uid="u", path="/x"))
    poll(lane)
    assert writer.take().message.frame_index == 0


def test_a_start_ack_that_is_said_twice_replays_once(lane, writer):
    make_ready(lane, writer)
    lane.offer(*frame(0))
    writer.take()
    writer.send(StartAck(scan_uid="u", path="/x"))
    poll(lane)
    assert writer.nothing()
