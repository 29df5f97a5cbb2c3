"""What is published on the results lane: maps and points in mid-sweep, the finished ones, and all to a newcomer."""

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
from process.worker.live_maps import samples_of, samples_on_disk
from process.worker.live_scan import LiveScan
from process.worker.publisher import MAPS_NS, ResultPublisher
from process.worker.scan_description import ScanDescription
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
def scan(source: SweepSource) -> Iterator[LiveScan]:
    """A scan whose frames are all folded."""
    made = LiveScan(ScanDescription.of_start(source.start_message), 2_000_000_000)
    for index in range(FRAMES):
        source.commit(index)
        made.take_image(source.image(index), memoryview(source.frames[index].tobytes()))
    yield made
    made.close()


@pytest.fixture
def publisher(run_dir: Path, source: SweepSource) -> Iterator[ResultPublisher]:
    context: zmq.Context = zmq.Context()
    made = ResultPublisher(bind(context, zmq.XPUB, run_dir, "results"))
    made.begin(source.scan_uid, source.format, 60)
    yield made
    context.destroy(linger=0)
    zmq_garbage.stop()  # pyzmq's thread that frees what was sent without a copy


@pytest.fixture
def listener(run_dir: Path, publisher: ResultPublisher) -> Iterator[Listener]:
    context: zmq.Context = zmq.Context()
    made = Listener(context, run_dir)
    assert publisher.socket.poll(5000), "the subscription arrives"
    yield made
    context.destroy(linger=0)


def finish(scan: LiveScan, source: SweepSource) -> Path:
    """Take the scan to its end; returns maps.h5."""
    scan.take_end(End(scan_uid=source.scan_uid, outcome=Outcome.COMPLETE, expected=FRAMES, sent=FRAMES))
    source.file.seal(Outcome.COMPLETE)
    return scan.finish().paths.maps


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


def test_a_subscriber_sees_the_maps_in_mid_sweep_and_those_of_the_file_at_the_end(scan, source, publisher, listener):
    publisher.maps(samples_of(scan.preview().maps), FRAMES - 1, 0)
    message, payload = wait_for(lambda: listener.poll().maps, "maps of a preview")[-1]
    assert (message.shape, message.step, message.contrast) == ([HEIGHT, WIDTH], 1, 60.0)
    assert message.folded_through == FRAMES - 1
    assert np.array_equal(planes(message, payload)[1], np.max(source.frames, axis=0))
    path = finish(scan, source)
    publisher.maps(samples_on_disk(path), FRAMES - 1, 0)
    message, payload = wait_for(lambda: listener.poll().maps[1:], "maps of the file")[-1]
    with h5py.File(path) as file:
        for found, name in zip(planes(message, payload), ("min", "max", "crossing"), strict=True):
            assert np.array_equal(found, file[name][()].astype(found.dtype), equal_nan=True)


def test_large_pictures_are_sampled_from_their_first_pixel_on(scan, source, monkeypatch):
    monkeypatch.setattr(live_maps, "MAX_SAMPLES", 400)
    samples = samples_of(scan.preview().maps)
    assert samples.step == 3
    assert np.array_equal(samples.minimum, np.min(source.frames, axis=0)[::3, ::3])


def test_maps_are_due_once_a_second_and_only_while_somebody_subscribes(scan, source, publisher):
    now_ns = 10 * MAPS_NS
    assert not publisher.maps_due(now_ns)
    subscriber = Listener(source.context, source.run_dir)
    assert publisher.socket.poll(5000) and publisher.answer_newcomers()
    assert publisher.maps_due(now_ns)
    publisher.maps(samples_of(scan.preview().maps), FRAMES - 1, now_ns)
    assert not publisher.maps_due(now_ns + MAPS_NS - 1)
    assert publisher.maps_due(now_ns + MAPS_NS)
    subscriber.close()
    assert publisher.socket.poll(5000), "the subscriber leaves"
    publisher.answer_newcomers()
    assert not publisher.maps_due(now_ns + MAPS_NS)


def test_a_newcomer_gets_progress_points_maps_and_end_without_waiting_for_the_next(scan, source, publisher, listener):
    maps = finish(scan, source)
    cloud = scan.results.cloud
    publisher.answer_newcomers()  # the first one: what is asked for later is asked for by the late one alone
    publisher.progress(scan.progress(), 0)
    publisher.points(cloud, np.zeros(len(cloud), bool), FRAMES - 1, final=True)
    publisher.maps(samples_on_disk(maps), FRAMES - 1, 0)
    publisher.results(scan.end_message())
    wait_for(lambda: listener.poll().ends, "the first subscriber has heard it all")
    late = Listener(source.context, source.run_dir)
    wait_for(lambda: (publisher.answer_newcomers(), late.poll().ends)[1], "everything again")
    late.close()
    assert (late.heard.ends[0].points, late.heard.ends[0].maps_path) == (len(cloud), str(maps))
    assert late.heard.maps[-1][1] == listener.heard.maps[-1][1]
    assert sum(tile.count for tile in late.heard.tiles[-1][0].tiles) == len(cloud)
    assert late.heard.progress[-1].folded_through == FRAMES - 1


def test_maps_that_were_taken_away_are_told_by_their_path(scan, source):
    path = finish(scan, source)
    path.write_bytes(b"no maps")
    with pytest.raises(ScanFileError, match=r"maps\.h5 is not a readable maps"):
        samples_on_disk(path)
