"""The writer's side of the frames lane, message by message, by a source that is spoken by hand."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import msgspec
import pytest
import zmq

from acquire.contract.messaging.lanes import Sender, bind, receive
from acquire.contract.messaging.messages import PROTOCOL, Ack, End, EndAck, Hello, Message, Nack, Start, StartAck
from acquire.contract.states import Outcome
from acquire.writer.verify import verify
from tests.fakes.processes.launch import Bench, Child, bench_at
from tests.fakes.scans.frames import image_of, pixels_of, start_of
from tests.waiting import DEADLINE_S, exit_status, wait_for

COUNT = 4


class Source:
    """The ROUTER side of the frames lane, one message at a time."""

    def __init__(self, run_dir: Path) -> None:
        self.context: zmq.Context[Any] = zmq.Context()
        self.socket = bind(self.context, zmq.ROUTER, run_dir, "frames")
        self.sender = Sender(self.socket)
        self.writer = b""

    def take(self, kind: type[Message], deadline_s: float = DEADLINE_S) -> Any:
        """The next message of ``kind``; hellos and heartbeats before it are passed over."""
        while True:
            wait_for(lambda: self.socket.poll(200), kind.__name__, deadline_s)
            received = receive(self.socket)
            assert received is not None
            self.writer = received.routing_id or b""
            message = received.message
            if isinstance(message, kind) and not (isinstance(message, Ack) and not message.frames):
                return message
            assert isinstance(message, (Hello, Ack)), message

    def send(self, message: Message, payload: Any = None) -> None:
        assert self.sender.send(message, payload, routing_id=self.writer)

    def send_raw(self, *parts: bytes) -> None:
        self.socket.send_multipart([self.writer, *parts])

    def close(self) -> None:
        self.context.destroy(linger=0)


@pytest.fixture
def bench(run_dir: Path, tmp_path: Path) -> Iterator[Bench]:
    with bench_at(run_dir, tmp_path) as made:
        yield made


@pytest.fixture
def source(bench: Bench) -> Iterator[Source]:
    with contextlib.closing(Source(bench.run_dir)) as made:
        yield made


@pytest.fixture
def writer(bench: Bench, source: Source) -> Child:
    child = bench.writer()
    source.take(Hello)
    return child


@pytest.fixture
def start(bench: Bench) -> Start:
    return start_of(bench.scan, COUNT)


def send_frame(source: Source, start: Start, frame_index: int, **changed: Any) -> None:
    pixels = pixels_of(frame_index, COUNT, start.format)
    source.send(image_of(frame_index, pixels, start, **changed), pixels)


def begin(source: Source, start: Start) -> StartAck:
    source.send(start)
    ack = source.take(StartAck)
    assert isinstance(ack, StartAck)
    return ack


def test_a_writer_without_a_scan_says_hello_again_and_again(source: Source, writer: Child) -> None:
    assert [source.take(Hello).pid for _ in range(2)] == [writer.process.pid] * 2


def test_the_file_is_there_when_the_start_is_acknowledged(source: Source, writer: Child, start: Start) -> None:
    ack = begin(source, start)
    assert Path(ack.path).name == "scan.partial.h5"
    assert Path(ack.path).is_file()
    assert (ack.committed, ack.crc32, ack.durable_count, ack.reserved) == ([], [], 0, True)


def test_a_start_that_is_repeated_is_answered_with_what_is_committed(
    source: Source, writer: Child, start: Start
) -> None:
    begin(source, start)
    send_frame(source, start, 2)
    item = source.take(Ack).frames[0]
    again = begin(source, start)
    assert (again.committed, again.crc32) == ([(2, 2)], [item.crc32])


def test_a_writer_that_waits_for_frames_sends_heartbeats(source: Source, writer: Child, start: Start) -> None:
    begin(source, start)
    while True:
        wait_for(lambda: source.socket.poll(200), "a heartbeat")
        received = receive(source.socket)
        assert received is not None
        if isinstance(received.message, Ack):
            assert (received.message.frames, received.message.committed_count) == ([], 0)
            return


def test_a_daemon_that_comes_back_hears_hello_at_once(bench: Bench, source: Source, writer: Child) -> None:
    source.close()
    with contextlib.closing(Source(bench.run_dir)) as again:
        assert again.take(Hello, deadline_s=3.0).pid == writer.process.pid


NONSENSE: list[tuple[bytes, ...]] = [
    (b"",),
    (b"\xc1",),
    (b"\x81\xa4type\xa5imag",),
    (msgpack.packb({"type": "image", "protocol": [1, 0]}),),
    (msgpack.packb({"type": "nonsense", "protocol": [1, 0]}), b"x"),
    (msgpack.packb({"type": "status", "protocol": [1, 0], "state": "idle"}),),
    (b"a", b"b", b"c"),
    (b"\xdd\xff\xff\xff\xff",),
    (b"\x91" * 100_000,),
    (b"\x81\xa4type\xa4\xff\xfe\xff\xfe",),
    (b"\0" * 1_000_000,),
]


def test_messages_that_make_no_sense_are_counted_and_ignored(source: Source, writer: Child, start: Start) -> None:
    begin(source, start)
    for frame_index, parts in enumerate(NONSENSE[:COUNT]):
        source.send_raw(*parts)
        send_frame(source, start, frame_index)
        assert source.take(Ack).committed_count == frame_index + 1
    for parts in NONSENSE[COUNT:]:
        source.send_raw(*parts)
    begin(source, start)
    assert writer.errors.count("invalid message") == min(10, len(NONSENSE))


def test_another_major_version_is_refused_with_both_named(source: Source, writer: Child) -> None:
    source.send_raw(msgpack.packb({"type": "start", "protocol": [2, 7]}))
    nack = source.take(Nack)
    ours = ".".join(map(str, PROTOCOL))
    assert (nack.reason, "2.7" in nack.detail, ours in nack.detail) == ("protocol", True, True)


def test_a_frame_of_a_scan_that_is_not_open_is_refused(source: Source, writer: Child, start: Start) -> None:
    send_frame(source, start, 1)
    nack = source.take(Nack)
    assert (nack.reason, nack.frame_index) == ("no such scan", 1)


def test_a_frame_without_pixels_is_refused(source: Source, writer: Child, start: Start) -> None:
    begin(source, start)
    source.send(image_of(0, pixels_of(0, COUNT, start.format), start))
    assert source.take(Nack).reason == "shape"


def test_a_frame_that_was_written_before_with_other_pixels_is_refused_by_name(
    source: Source, writer: Child, start: Start
) -> None:
    begin(source, start)
    send_frame(source, start, 0)
    source.take(Ack)
    other = pixels_of(0, COUNT, start.format, seed=9)
    source.send(image_of(0, other, start, attempt=1), other)
    nack = source.take(Nack)
    assert (nack.reason, nack.frame_index, nack.attempt) == ("immutable", 0, 1)


def test_check_frames_are_acknowledged_by_their_role(source: Source, writer: Child, start: Start) -> None:
    begin(source, start)
    send_frame(source, start, 0, role="dark")
    ack = source.take(Ack)
    assert ([item.role for item in ack.frames], ack.committed_count) == (["dark"], 0)


def test_many_frames_at_once_are_answered_by_few_acks(source: Source, writer: Child, bench: Bench) -> None:
    start = start_of(bench.scan, 200)
    begin(source, start)
    writer.process.send_signal(signal.SIGSTOP)
    for frame_index in range(200):
        send_frame(source, start, frame_index)
    writer.process.send_signal(signal.SIGCONT)
    sizes = []
    while sum(sizes) < 200:
        sizes.append(len(source.take(Ack).frames))
    assert max(sizes) == 32
    assert len(sizes) <= 20


def test_an_end_that_is_repeated_is_confirmed_again(source: Source, writer: Child, start: Start) -> None:
    begin(source, start)
    for frame_index in range(COUNT):
        send_frame(source, start, frame_index)
    end = End(scan_uid=start.scan_uid, outcome=Outcome.COMPLETE, expected=COUNT, sent=COUNT)
    source.send(end)
    first = source.take(EndAck)
    source.send(end)
    again = source.take(EndAck)
    assert first.sealed
    assert (again.path, again.digest, again.sealed) == (first.path, first.digest, True)
    assert verify(Path(first.path)).complete


def test_a_complete_end_with_missing_frames_leaves_the_scan_open_and_names_them(
    source: Source, writer: Child, start: Start
) -> None:
    begin(source, start)
    for frame_index in (0, 2):
        send_frame(source, start, frame_index)
    end = End(scan_uid=start.scan_uid, outcome=Outcome.COMPLETE, expected=COUNT, sent=COUNT)
    source.send(end)
    refused = source.take(EndAck)
    assert (refused.sealed, refused.outcome, refused.missing) == (False, Outcome.RUNNING, [(1, 1), (3, 3)])
    source.send(msgspec.structs.replace(end, outcome=Outcome.FAILED, reason="frames 1 and 3 were lost"))
    sealed = source.take(EndAck)
    assert (sealed.sealed, sealed.outcome, sealed.missing) == (True, Outcome.FAILED, [(1, 1), (3, 3)])


def test_an_interrupted_end_leaves_the_scan_partial_with_its_reason(
    source: Source, writer: Child, bench: Bench, start: Start
) -> None:
    begin(source, start)
    send_frame(source, start, 0)
    source.send(End(scan_uid=start.scan_uid, outcome=Outcome.INTERRUPTED, reason="F13 reset", expected=COUNT, sent=1))
    answer = source.take(EndAck)
    assert not answer.sealed and answer.outcome is Outcome.INTERRUPTED and answer.missing == [(1, COUNT - 1)]
    report = verify(bench.scan)
    assert (report.outcome, report.reason, report.sealed, report.committed) == ("interrupted", "F13 reset", False, 1)


def test_an_end_of_a_scan_that_is_not_open_is_refused(source: Source, writer: Child) -> None:
    source.send(End(scan_uid="gone", outcome=Outcome.STOPPED, expected=1, sent=0))
    assert source.take(Nack).reason == "no such scan"


def test_a_new_scan_leaves_the_one_before_partial(source: Source, writer: Child, bench: Bench, start: Start) -> None:
    begin(source, start)
    send_frame(source, start, 0)
    source.take(Ack)
    other = start_of(bench.folder / "other", COUNT, scan_uid="fake-2")
    begin(source, other)
    assert verify(bench.scan).committed == 1
    assert (bench.folder / "other" / "scan.partial.h5").is_file()


def test_a_scan_with_another_plan_in_its_folder_is_refused(source: Source, writer: Child, bench: Bench) -> None:
    first = start_of(bench.scan, COUNT)
    begin(source, first)
    begin(source, start_of(bench.folder / "other", COUNT, scan_uid="fake-2"))
    source.send(start_of(bench.scan, COUNT + 1))
    assert source.take(Nack).reason == "exists"


def test_a_scan_without_room_is_refused_before_anything_moves(source: Source, bench: Bench, writer: Child) -> None:
    import resource

    resource.prlimit(writer.process.pid, resource.RLIMIT_FSIZE, (10_000, resource.RLIM_INFINITY))
    source.send(start_of(bench.scan, COUNT))
    nack = source.take(Nack)
    assert (nack.reason, "storage.data_dir" in nack.detail) == ("no space", True)
    assert not bench.scan.exists()


def test_a_folder_that_cannot_be_made_is_refused_with_a_way_out(source: Source, bench: Bench, writer: Child) -> None:
    (bench.folder / "taken").write_text("a file")
    source.send(start_of(bench.folder / "taken" / "scan", COUNT))
    nack = source.take(Nack)
    assert (nack.reason, "storage.data_dir" in nack.detail) == ("io error", True)


def test_a_superseded_writer_stops_writing_and_leaves(source: Source, writer: Child, start: Start) -> None:
    begin(source, start)
    source.send(Nack(reason="superseded"))
    send_frame(source, start, 0)
    assert exit_status(writer.process) == 1
    assert "another writer has taken over" in writer.errors
