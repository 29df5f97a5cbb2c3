"""The writer as a process, fed by a fake camera whose own log is the witness."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from acquire.contract.scan_data.reader import ScanReader
from acquire.writer.scan_file import create_scan
from acquire.writer.verify import verify
from tests.fakes.processes.launch import Bench, bench_at
from tests.fakes.scans.frames import pixels_of, start_of
from tests.waiting import exit_status, wait_for


@pytest.fixture
def bench(run_dir: Path, tmp_path: Path) -> Iterator[Bench]:
    with bench_at(run_dir, tmp_path) as made:
        yield made


def assert_file_equals_witness(bench: Bench, count: int, seed: int = 0) -> None:
    """Every frame that the camera logged is in the file, bit for bit, once, in its place."""
    said = [tuple(map(int, line.split())) for line in bench.witness.read_text().splitlines()]
    assert [frame_index for frame_index, _, _ in said] == list(range(count))
    with ScanReader(bench.scan) as reader:
        for frame_index, trigger_id, crc32 in said:
            assert np.array_equal(reader.frame(frame_index), pixels_of(frame_index, count, reader.layout.format, seed))
            assert reader.field("trigger_id")[frame_index] == trigger_id
            assert reader.field("crc32")[frame_index] == crc32
    assert verify(bench.scan).complete


def test_the_file_equals_the_witness_bit_for_bit(bench: Bench) -> None:
    bench.writer()
    result = bench.camera(120, bit_depth=12, pixel_format="rgb", seed=5).result()
    assert result["end_ack"]["sealed"]
    assert result["end_ack"]["outcome"] == "complete"
    assert result["kept_bytes"] == 0
    assert_file_equals_witness(bench, 120, seed=5)


def test_damaged_doubled_and_conflicting_frames_do_the_file_no_harm(bench: Bench) -> None:
    bench.writer()
    result = bench.camera(150, bad=0.1, duplicate=0.2, conflict=0.1, seed=2).result()
    assert result["nacks"]["immutable"] == result["counters"]["conflicts"] > 0
    assert result["nacks"]["shape"] + result["nacks"]["crc"] == result["counters"]["bad"] > 0
    assert result["counters"]["duplicates"] > 0
    assert_file_equals_witness(bench, 150, seed=2)


def test_a_writer_that_starts_after_the_camera_is_found(bench: Bench) -> None:
    camera = bench.camera(20)
    wait_for((bench.run_dir / "frames.sock").exists, "the camera's socket")
    bench.writer()
    camera.result()
    assert_file_equals_witness(bench, 20)


def test_frames_become_durable_while_the_sweep_runs(bench: Bench) -> None:
    bench.writer(STORAGE__SYNC_EVERY_FRAMES=8)
    camera = bench.camera(200, delay_ms=5)
    wait_for(lambda: len(bench.acked()) > 40, "acks")

    def durable() -> int:
        with ScanReader(bench.scan) as reader:
            return int(reader.scalar("durable_count"))

    wait_for(lambda: durable() >= 32, "durable frames")
    assert camera.process.poll() is None, "that was during the sweep"
    assert camera.result()["durable"] > 0


def test_a_stopped_sweep_is_sealed_as_stopped(bench: Bench) -> None:
    bench.writer()
    ack = bench.camera(10, outcome="stopped").result()["end_ack"]
    assert (ack["sealed"], ack["outcome"], ack["committed"]) == (True, "stopped", 10)
    assert not verify(bench.scan).complete


def test_a_folder_that_holds_another_scan_is_refused_and_left_alone(bench: Bench) -> None:
    create_scan(bench.scan, start_of(bench.scan, 10, scan_uid="somebody-else")).close()
    before = (bench.scan / "scan.partial.h5").read_bytes()
    writer = bench.writer()
    camera = bench.camera(10, deadline_s=1)
    assert exit_status(camera.process) != 0
    assert "holds another scan (somebody-else)" in writer.errors
    assert (bench.scan / "scan.partial.h5").read_bytes() == before


def test_a_second_writer_leaves_with_the_pid_of_the_first(bench: Bench) -> None:
    first = bench.writer()
    wait_for(lambda: "ready" in first.errors, "the writer")
    second = bench.writer()
    assert exit_status(second.process) == 1
    assert f"pid {first.process.pid}" in second.errors


def test_a_writer_without_anybody_leaves_at_sigterm(bench: Bench) -> None:
    writer = bench.writer()
    wait_for(lambda: "ready" in writer.errors, "the writer")
    assert writer.terminate() == 0


def test_sigterm_in_mid_sweep_leaves_everything_durable_and_partial(bench: Bench) -> None:
    writer = bench.writer(STORAGE__SYNC_EVERY_FRAMES=100_000)
    bench.camera(300, delay_ms=3)
    wait_for(lambda: len(bench.acked()) > 30, "acks")
    assert writer.terminate() == 0
    with ScanReader(bench.scan) as reader:
        committed = reader.committed_through() + 1
        assert committed > 30
        assert reader.scalar("durable_count") == committed
        assert (reader.layout.path.name, reader.outcome) == ("scan.partial.h5", "running")


def test_a_frozen_writer_stops_the_camera_and_nothing_is_lost(bench: Bench) -> None:
    writer = bench.writer()
    camera = bench.camera(120, delay_ms=2, slots=8)
    wait_for(lambda: len(bench.acked()) > 10, "acks")
    os.kill(writer.process.pid, signal.SIGSTOP)
    seen = wait_for(lambda: _stands_still(bench), "no more frames than credit")
    assert seen <= len(bench.acked()) + 8
    os.kill(writer.process.pid, signal.SIGCONT)
    camera.result()
    assert_file_equals_witness(bench, 120)


def _stands_still(bench: Bench) -> int:
    before = len(bench.witness.read_text().splitlines())
    end = time.monotonic() + 0.3
    while time.monotonic() < end:
        if len(bench.witness.read_text().splitlines()) != before:
            return 0
    return before


def test_a_reader_that_holds_the_file_open_throughout_disturbs_nothing(bench: Bench) -> None:
    bench.writer()
    camera = bench.camera(100, delay_ms=2)
    wait_for((bench.scan / "scan.partial.h5").exists, "the file")
    with h5py.File(bench.scan / "scan.partial.h5") as file:
        held = file["/entry/data/data"]
        ack = camera.result()["end_ack"]
        assert ack["sealed"]
        assert held.shape[0] == 100
    assert_file_equals_witness(bench, 100)


def test_a_polling_reader_sees_each_commit_within_50_ms_of_its_ack(bench: Bench) -> None:
    bench.writer()
    camera = bench.camera(150, delay_ms=3)
    wait_for((bench.scan / "scan.partial.h5").exists, "the file")
    unseen_ns = np.zeros(150, dtype=np.int64)
    with ScanReader(bench.scan) as reader:
        while camera.process.poll() is None:
            asked_ns = time.monotonic_ns()
            unseen_ns[~reader.present()] = asked_ns
    acked_ns = dict(tuple(map(int, line.split())) for line in bench.acks.read_text().splitlines())
    assert len(acked_ns) == 150
    # a question that was asked so long after the ack and still did not show the frame
    late_ms = [(unseen_ns[frame_index] - acked_ns[frame_index]) / 1e6 for frame_index in range(150)]
    assert max(late_ms) < 50


def test_plain_h5py_opens_the_file_at_any_moment_from_creation_to_rename(bench: Bench) -> None:
    bench.writer()
    camera = bench.camera(100, delay_ms=2)
    opened = {"scan.partial.h5": 0, "scan.h5": 0}
    while camera.process.poll() is None:
        for name in opened:
            if not (bench.scan / name).exists():
                continue
            try:
                with h5py.File(bench.scan / name) as file:
                    assert file["/entry/data/data"].shape == (100, 48, 64)
                    assert file["/entry/data/status"][:].max() <= 1
                opened[name] += 1
            except OSError:
                # HDF5 opens a name, then asks for its state by name: the one excuse is that sealing renamed it between
                assert not (bench.scan / name).exists()
    assert opened["scan.partial.h5"] > 3
    assert_file_equals_witness(bench, 100)
