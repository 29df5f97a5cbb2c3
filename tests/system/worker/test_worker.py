"""The worker as a process: whatever happens to it or to the live lane, its result is that of reconstruct."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path

import h5py
import msgspec
import numpy as np
import pytest

from acquire.contract.messaging.codec import encode
from acquire.contract.messaging.point_record import POINT
from acquire.contract.states import Outcome
from process.results.reconstruct import reconstruct
from process.results.settings import ReconstructOptions
from tests.fakes.processes.sweep_source import Listener, SweepSource, edge_frames
from tests.waiting import output_of, wait_for

FRAMES, WIDTH, HEIGHT = 60, 128, 96


@pytest.fixture
def source(run_dir: Path, tmp_path: Path) -> Iterator[SweepSource]:
    made = SweepSource(run_dir, tmp_path / "scan", edge_frames(FRAMES, WIDTH, HEIGHT, colour=True))
    try:
        yield made
    finally:
        made.close()


def ready(source: SweepSource) -> Listener:
    source.start_worker()
    listener = source.listen()
    source.wait_for_subscribers(listener)
    source.create()
    source.announce()
    return listener


def folded(source: SweepSource, listener: Listener, through: int) -> None:
    def there() -> bool:
        found = [p for p in listener.poll().progress if p.scan_uid == source.scan_uid]
        return bool(found) and found[-1].folded_through >= through

    source.pump(there, f"frame {through} is folded")


def sweep(source: SweepSource, listener: Listener, frames: range) -> None:
    """Take frames no faster than they are folded: a full queue would drop some of them, and rightly."""
    for index in frames:
        source.take(index)
        if index % 10 == 9:
            folded(source, listener, index)


def finished(source: SweepSource, listener: Listener) -> dict:
    source.pump(lambda: listener.poll().ends, "the results are on disk")
    return json.loads((source.folder / "report.json").read_text())


def assert_same_as_reconstruct(source: SweepSource, tmp_path: Path) -> None:
    summary = reconstruct(source.folder, ReconstructOptions(out=tmp_path / "again"))
    with h5py.File(source.folder / "maps.h5") as live, h5py.File(summary.paths.maps) as again:
        names = [name for name in live if isinstance(live[name], h5py.Dataset)]
        assert set(live) == set(again) and len(names) == 7
        for name in names:
            assert live[name].dtype == again[name].dtype
            assert np.array_equal(live[name][()], again[name][()], equal_nan=live[name].dtype.kind == "f"), name
        assert dict(live.attrs) == dict(again.attrs)
    assert (source.folder / "cloud.ply").read_bytes() == summary.paths.cloud.read_bytes()
    assert summary.points is not None and summary.points > 0.5 * WIDTH * HEIGHT


def test_an_undisturbed_sweep_is_folded_from_the_live_lane_and_equals_reconstruct(source, tmp_path):
    listener = ready(source)
    sweep(source, listener, range(FRAMES))
    source.end()
    report = finished(source, listener)
    assert report["counts"]["from_live"] == FRAMES
    assert report["counts"]["from_file"] == report["counts"]["refolded"] == 0
    assert (report["outcome"], report["sweep"]["drift_px"]) == ("complete", 0.25)
    assert report["speed"]["ratio"] == pytest.approx(1.0)
    assert_same_as_reconstruct(source, tmp_path)


def test_frames_lost_on_the_live_lane_are_read_from_the_file(source, tmp_path):
    listener = ready(source)
    for index in range(FRAMES):
        source.take(index, live=index % 7 != 3 and not 20 <= index < 31)
    source.end()
    report = finished(source, listener)
    assert report["counts"]["from_file"] >= 18
    assert report["counts"]["from_live"] + report["counts"]["from_file"] == FRAMES
    assert_same_as_reconstruct(source, tmp_path)


def test_a_gap_waits_until_the_frame_is_committed(source, tmp_path):
    listener = ready(source)
    for index in range(10):
        source.send_live(index)
    source.send_live(11)
    folded(source, listener, 9)
    assert listener.heard.progress[-1].folded_through == 9, "frame 10 is nowhere yet"
    source.commit(10)
    folded(source, listener, 11)
    for index in [*range(10), *range(11, FRAMES)]:
        source.take(index, live=index > 11)
    source.end()
    assert finished(source, listener)["counts"]["from_file"] == 1
    assert_same_as_reconstruct(source, tmp_path)


def test_doubled_and_broken_live_frames_and_foreign_messages_do_no_harm(source, tmp_path):
    listener = ready(source)
    for index in range(FRAMES):
        source.take(index, live=index not in (5, 6, 7, 8))
        if index == 5:
            source.send_live(index, crc32=1)
        if index == 6:
            source.send_live(index, pixels=b"short")
        if index == 7:
            source.send_live(index, shape=[HEIGHT, WIDTH])
        if index == 8:
            source.send_live(index, scan_uid="another scan")
        if index == 9:
            source.send_live_raw([b"\xc1 no message", b""])
            source.send_live_raw([encode(source.start_message), b"", b"", b""])
            source.send_live(index)
            source.send_live(3)
        if index == 12:
            source.send_live(0, role="repeat")
    source.end()
    counts = finished(source, listener)["counts"]
    assert (counts["from_live"], counts["from_file"]) == (FRAMES - 4, 4), counts
    assert (counts["live_wrong_crc"], counts["live_malformed"], counts["live_foreign"]) == (1, 2, 1)
    assert_same_as_reconstruct(source, tmp_path)


def test_a_live_frame_that_differs_from_the_file_is_found_and_everything_is_folded_again(source, tmp_path):
    listener = ready(source)
    other = np.full_like(source.frames[30], 255)
    for index in range(FRAMES):
        source.take(index, live=index != 30)
        if index == 30:
            source.send_live(30, pixels=other.tobytes(), crc32=source_crc(other))
    source.end()
    report = finished(source, listener)
    assert report["counts"]["refolded"] == FRAMES
    assert report["counts"]["from_file"] == FRAMES
    assert_same_as_reconstruct(source, tmp_path)


def test_killed_and_started_again_twice_in_mid_sweep_it_ends_with_the_same_result(source, tmp_path):
    listener = ready(source)
    for stop in (20, 40):
        for index in range(stop - 20, stop):
            source.take(index)
        folded(source, listener, stop - 1)
        source.kill_worker()
        source.take(stop)
        source.start_worker()
        listener = source.listen()
        folded(source, listener, stop)
        for index in range(stop + 1, stop + 20):
            source.take(index)
    source.end()
    finished(source, listener)
    assert_same_as_reconstruct(source, tmp_path)


def test_a_worker_that_finds_an_ended_scan_without_maps_makes_them(source, tmp_path):
    source.create()
    for index in range(FRAMES):
        source.take(index, live=False)
    source.end(live=False)
    source.start_worker()
    listener = source.listen()
    report = finished(source, listener)
    assert report["counts"]["from_file"] == FRAMES
    assert_same_as_reconstruct(source, tmp_path)


def test_results_that_are_there_already_are_left_alone_and_shown(source):
    source.create()
    for index in range(FRAMES):
        source.take(index, live=False)
    source.end(live=False)
    reconstruct(source.folder, ReconstructOptions())
    written = (source.folder / "maps.h5").stat().st_mtime_ns
    source.start_worker()
    listener = source.listen()
    source.pump(lambda: listener.poll().ends and listener.heard.tiles[-1][0].tiles, "the cloud of the last scan")
    assert (source.folder / "maps.h5").stat().st_mtime_ns == written
    assert listener.heard.ends[-1].points == len(listener.heard.tiles[-1][1]) // POINT.itemsize


def test_a_stopped_sweep_has_results_of_the_frames_that_are_there(source, tmp_path):
    listener = ready(source)
    for index in range(45):
        if index != 22:
            source.take(index)
    source.end(Outcome.STOPPED, missing=[(22, 22), (45, FRAMES - 1)])
    report = finished(source, listener)
    assert (report["outcome"], report["counts"]["missing"]) == ("stopped", FRAMES - 44)
    assert_same_as_reconstruct(source, tmp_path)


def test_an_end_that_was_lost_is_learned_from_the_status(source, tmp_path):
    listener = ready(source)
    for index in range(50):
        source.take(index)
    source.end(Outcome.ABORTED, live=False)
    assert finished(source, listener)["outcome"] == "aborted"
    assert_same_as_reconstruct(source, tmp_path)


def test_tiles_add_up_to_the_cloud_and_newcomers_get_all_of_them(source):
    listener = ready(source)
    for index in range(FRAMES):
        source.take(index)
        if index == 40:
            folded(source, listener, 40)
            wait_for(lambda: len(listener.poll().tiles) > 1, "tiles in mid-sweep")
    source.end()
    finished(source, listener)
    early, late = listener, source.listen()
    wait_for(lambda: late.poll().ends and late.heard.tiles, "everything again for a newcomer")
    clouds = []
    for ear in (early, late):
        tiles: dict[int, np.ndarray] = {}
        for message, payload in [pair for pair in ear.heard.tiles if pair[0].scan_uid == source.scan_uid]:
            if message.snapshot:
                tiles.clear()
            points, at = np.frombuffer(payload, POINT), 0
            for header in message.tiles:
                part = points[at : at + header.count]
                at += header.count
                assert header.provisional == part["provisional"].sum()
                tiles[header.tile] = np.stack([part[axis] for axis in "xyz"], axis=1) + np.array(header.origin_mm)
        clouds.append(np.concatenate(list(tiles.values())))
    report = json.loads((source.folder / "report.json").read_text())
    assert len(clouds[0]) == len(clouds[1]) == report["counts"]["points"]
    assert any(header.provisional for message, _ in early.heard.tiles for header in message.tiles)
    assert late.heard.progress[-1].points_provisional == 0


def test_a_sweep_without_calibration_gets_maps_and_says_why_there_is_no_cloud(run_dir, tmp_path):
    source = SweepSource(run_dir, tmp_path / "scan", edge_frames(20, 64, 48), calibrated=False)
    try:
        listener = ready(source)
        for index in range(20):
            source.take(index)
        source.end()
        finished(source, listener)
        assert (source.folder / "maps.h5").is_file() and not (source.folder / "cloud.ply").exists()
        assert "no calibration" in listener.heard.ends[-1].message
    finally:
        source.close()


def test_a_fold_beyond_the_memory_limit_is_refused_in_words(source, monkeypatch):
    monkeypatch.setenv("SWEEPSCOPE_LIMITS__FOLD_BYTES", "1000000")
    listener = ready(source)
    words = source.pump(
        lambda: [p.message for p in listener.poll().progress if p.scan_uid == source.scan_uid], "a refusal"
    )
    assert "limits.fold_bytes allows 1.0 MB" in words[-1] and "scan itself is safe" in words[-1]


def test_a_second_worker_leaves_with_the_pid_of_the_first(source):
    first = source.start_worker()
    wait_for(lambda: (source.run_dir / "worker.lock").read_text().strip(), "the lock")
    second = source.start_worker_unready()
    _, said = output_of(second)
    assert second.returncode != 0
    assert str(first.pid) in said


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_leaves_cleanly_when_told_so(source, number):
    worker = source.start_worker()
    listener = source.listen()
    wait_for(lambda: listener.poll().progress, "a sign of life")
    worker.send_signal(number)
    _, said = output_of(worker)
    assert worker.returncode == 0, said
    assert "Traceback" not in said


def source_crc(pixels: np.ndarray) -> int:
    from acquire.contract.scan_data.checksums import frame_crc32

    return frame_crc32(pixels)


def test_progress_is_decodable_by_its_own_bounds(source):
    listener = ready(source)
    source.take(0)
    folded(source, listener, 0)
    assert msgspec.to_builtins(listener.heard.progress[-1])["expected"] == FRAMES
