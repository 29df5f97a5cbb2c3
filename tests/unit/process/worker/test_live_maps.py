"""The maps on the results lane: what is sent, to whom, and that it is the truth."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest
import zmq
from zmq.utils.garbage import gc as zmq_garbage

from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.lanes import bind
from acquire.contract.messaging.messages import End
from acquire.contract.scan_data.maps_file import sample_step
from acquire.contract.states import Outcome
from process.worker import live_maps
from process.worker.publisher import Outbox
from process.worker.scan_description import announced_by_start
from process.worker.session import ScanSession
from tests.fakes.processes.sweep_source import Listener, SweepSource, edge_frames
from tests.waiting import wait_for

FRAMES, WIDTH, HEIGHT = 30, 64, 48


@pytest.fixture
def source(run_dir: Path, tmp_path: Path) -> Iterator[SweepSource]:
    made = SweepSource(run_dir, tmp_path / "scan", edge_frames(FRAMES, WIDTH, HEIGHT))
    made.create()
    yield made
    made.close()


@pytest.fixture
def session(source: SweepSource) -> Iterator[ScanSession]:
    made = ScanSession(announced_by_start(source.start_message), 2_000_000_000)
    yield made
    made.close()


@pytest.fixture
def outbox(run_dir: Path) -> Iterator[Outbox]:
    context: zmq.Context = zmq.Context()
    yield Outbox(bind(context, zmq.XPUB, run_dir, "results"))
    context.destroy(linger=0)
    zmq_garbage.stop()  # pyzmq's thread that frees what was sent without a copy


@pytest.fixture
def listener(run_dir: Path, outbox: Outbox) -> Iterator[Listener]:
    context: zmq.Context = zmq.Context()
    made = Listener(context, run_dir)
    assert outbox.socket.poll(5000), "the subscription arrives"
    yield made
    context.destroy(linger=0)


def sweep(session: ScanSession, source: SweepSource) -> None:
    for index in range(FRAMES):
        source.commit(index)
        session.take_image(source.image(index), memoryview(source.frames[index].tobytes()))


def finish(session: ScanSession, source: SweepSource) -> None:
    session.take_end(End(scan_uid=source.scan_uid, outcome=Outcome.COMPLETE, expected=FRAMES, sent=FRAMES))
    source.file.seal(Outcome.COMPLETE)
    session.finish()


def planes(message, payload: bytes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    count = message.shape[0] * message.shape[1]
    low, high = (np.frombuffer(payload, "<u2", count, 2 * count * k).reshape(message.shape) for k in (0, 1))
    return low, high, np.frombuffer(payload, "<f4", count, 4 * count).reshape(message.shape)


@pytest.mark.parametrize(
    ("size", "step"), [((48, 64), 1), ((768, 1024), 2), ((3648, 5472), 11), ((1, 16_384), 1), ((16_384, 16_384), 37)]
)
def test_samples_are_as_near_as_the_bound_allows(size, step):
    found = sample_step(*size, live_maps.MAX_SAMPLES)
    assert found == step
    assert -(-size[0] // found) * -(-size[1] // found) <= live_maps.MAX_SAMPLES


def test_a_subscriber_sees_the_maps_in_mid_sweep_and_those_of_the_file_at_the_end(session, source, outbox, listener):
    outbox.begin(session)
    outbox.answer_newcomers(session)
    sweep(session, source)
    outbox.say_preview(session)
    message, payload = wait_for(lambda: listener.poll().maps, "maps of a preview")[-1]
    assert (message.shape, message.step, message.contrast) == ([HEIGHT, WIDTH], 1, 60.0)
    assert message.folded_through == FRAMES - 1
    assert np.array_equal(planes(message, payload)[1], np.max(source.frames, axis=0))
    finish(session, source)
    outbox.say_maps_on_disk(session)
    message, payload = wait_for(lambda: listener.poll().maps[1:], "maps of the file")[-1]
    with h5py.File(source.folder / "maps.h5") as file:
        for found, name in zip(planes(message, payload), ("min", "max", "crossing"), strict=True):
            assert np.array_equal(found, file[name][()].astype(found.dtype), equal_nan=True)


def test_large_pictures_are_sampled_from_their_first_pixel_on(session, source, outbox, listener, monkeypatch):
    monkeypatch.setattr(live_maps, "MAX_SAMPLES", 400)
    sweep(session, source)
    message, payload = live_maps.sampled(session, session.preview().maps)
    assert message.step == 3
    low, _, _ = planes(message, payload)
    assert np.array_equal(low, np.min(source.frames, axis=0)[::3, ::3])


def test_without_a_subscriber_no_maps_are_made(session, source, outbox, monkeypatch):
    monkeypatch.setattr(live_maps, "sampled", lambda *_: pytest.fail("nobody looks"))
    monkeypatch.setattr(live_maps, "on_disk", lambda *_: pytest.fail("nobody looks"))
    outbox.begin(session)
    sweep(session, source)
    outbox.say_preview(session)
    finish(session, source)
    outbox.say_maps_on_disk(session)


def test_a_newcomer_need_not_wait_for_the_next_frame(session, source, outbox, listener):
    outbox.begin(session)
    sweep(session, source)
    outbox.answer_newcomers(session)
    assert outbox.wants_preview
    outbox.say_preview(session)
    assert not outbox.wants_preview
    wait_for(lambda: listener.poll().maps, "maps")


def test_maps_that_were_taken_away_are_passed_over(session, source, outbox, listener):
    outbox.begin(session)
    outbox.answer_newcomers(session)
    sweep(session, source)
    finish(session, source)
    (source.folder / "maps.h5").write_bytes(b"no maps")
    with pytest.raises(ScanFileError, match="is not a readable maps"):
        live_maps.on_disk(session, source.folder / "maps.h5")
    outbox.say_maps_on_disk(session)
