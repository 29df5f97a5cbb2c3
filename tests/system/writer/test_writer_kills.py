"""The writer dies at every point where it hurts; another takes over, and no frame is lost, doubled or torn."""

from __future__ import annotations

import resource
import signal
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.scan_data.reader import ScanReader
from acquire.writer.verify import verify
from tests.fakes.processes.launch import Bench, Child, bench_at
from tests.fakes.scans.frames import pixels_of
from tests.system.writer.test_writer import assert_file_equals_witness
from tests.waiting import wait_for

_DYING_WRITER = """
import functools, os, signal, sys
from pathlib import Path
from acquire.contract.config.load import load_config
from acquire.contract.scan_data.file_layout import read_layout
from acquire.writer import scan_file
from acquire.writer.service import run_writer

def path_of(fd):
    return Path(os.readlink(f"/proc/self/fd/{fd}"))

@functools.cache
def regions_of(path):
    return read_layout(path).regions

def write_of(region, index=0):
    def matches(fd, data, offset):
        place = regions_of(path_of(fd))[region]
        size = place.nbytes // place.shape[0] if place.shape else place.nbytes
        return offset == place.offset + index * size
    return matches

POINTS = {
    "sync of the new file": (os, "fsync", lambda fd: path_of(fd).name.startswith(".creating-")),
    "name scan.partial.h5": (scan_file, "rename_new", lambda source, target: target.name == "scan.partial.h5"),
    "pixels of frame 8": (os, "pwrite", write_of("data", 8)),
    "status of frame 8": (os, "pwrite", write_of("status", 8)),
    "check of the frames": (os, "preadv", lambda *_: True),
    "outcome": (os, "pwrite", write_of("outcome")),
    "name scan.h5": (scan_file, "rename_new", lambda source, target: target.name == "scan.h5"),
}

def die_at(point, when):
    owner, name, matches = POINTS[point]
    real = getattr(owner, name)
    def call(*args):
        here = matches(*args)
        if here and when == "half":
            real(args[0], args[1][: len(args[1]) // 2], *args[2:])
        if here and when != "after":
            os.kill(os.getpid(), signal.SIGKILL)
        found = real(*args)
        if here:
            os.kill(os.getpid(), signal.SIGKILL)
        return found
    setattr(owner, name, call)

die_at(sys.argv[2], sys.argv[3])
run_writer(load_config(), Path(sys.argv[1]))
"""


@pytest.fixture
def bench(run_dir: Path, tmp_path: Path) -> Iterator[Bench]:
    with bench_at(run_dir, tmp_path) as made:
        yield made


def dying_writer(bench: Bench, point: str, when: str) -> Child:
    """A writer that kills itself where it writes (syncs, names, reads) what ``point`` says: before, half-way, after."""
    return bench.start("writer", ["-c", _DYING_WRITER, str(bench.run_dir), point, when])


def dies(writer: Child) -> None:
    assert writer.process.wait(30) == -signal.SIGKILL, writer.errors


def assert_what_was_acked_is_there(bench: Bench, count: int) -> None:
    """The file opens plainly with nobody around, and every frame that was acked is exact."""
    with h5py.File(bench.scan / "scan.partial.h5") as file:
        status, data = file["/entry/data/status"][:], file["/entry/data/data"][:]
    committed = np.flatnonzero(status).tolist()
    assert set(bench.acked()) <= set(committed)
    for frame_index in committed:
        assert np.array_equal(data[frame_index], pixels_of(frame_index, count, FrameFormat(64, 48, 8)))
    assert verify(bench.scan).ok


def test_a_writer_killed_three_times_in_mid_sweep_leaves_no_gap_and_no_duplicate(bench: Bench) -> None:
    writer = bench.writer()
    camera = bench.camera(240, delay_ms=2)
    for progress in (20, 80, 150):
        wait_for(lambda wanted=progress: len(bench.acked()) > wanted, "acks")
        writer.kill()
        assert_what_was_acked_is_there(bench, 240)
        writer = bench.writer()
    result = camera.result()
    assert result["counters"]["came_back"] == 3
    assert sorted(bench.acked()) == list(range(240))
    assert_file_equals_witness(bench, 240)


@pytest.mark.parametrize(
    ("point", "when"),
    [("sync of the new file", "before"), ("name scan.partial.h5", "before"), ("name scan.partial.h5", "after")],
)
def test_a_writer_killed_while_it_makes_the_file_is_followed_by_one_that_makes_it(
    bench: Bench, point: str, when: str
) -> None:
    camera = bench.camera(20)
    dies(dying_writer(bench, point, when))
    bench.writer()
    camera.result()
    assert [path.name for path in bench.scan.iterdir()] == ["scan.h5"], "no leftovers"
    assert_file_equals_witness(bench, 20)


@pytest.mark.parametrize(
    ("point", "when", "committed"),
    [("pixels of frame 8", "half", 0), ("status of frame 8", "before", 0), ("status of frame 8", "after", 1)],
)
def test_a_writer_killed_within_a_frame_tears_nothing_that_counts(
    bench: Bench, point: str, when: str, committed: int
) -> None:
    camera = bench.camera(20)
    dies(dying_writer(bench, point, when))
    assert_what_was_acked_is_there(bench, 20)
    with ScanReader(bench.scan) as reader:
        assert reader.status()[8] == committed
    bench.writer()
    camera.result()
    assert_file_equals_witness(bench, 20)


@pytest.mark.parametrize(
    ("point", "when"),
    [
        ("check of the frames", "before"),
        ("outcome", "after"),
        ("name scan.h5", "before"),
        ("name scan.h5", "after"),
    ],
)
def test_a_writer_killed_while_it_seals_is_followed_by_one_that_seals(bench: Bench, point: str, when: str) -> None:
    camera = bench.camera(20)
    dies(dying_writer(bench, point, when))
    bench.writer()
    ack = camera.result()["end_ack"]
    assert (ack["sealed"], ack["outcome"], ack["committed"]) == (True, "complete", 20)
    assert_file_equals_witness(bench, 20)


def test_a_disk_that_fills_up_in_mid_sweep_holds_the_sweep_until_there_is_space(bench: Bench) -> None:
    writer = bench.writer()
    camera = bench.camera(100, delay_ms=3)
    wait_for(lambda: len(bench.acked()) > 10, "acks")
    with ScanReader(bench.scan) as reader:
        limit = reader.layout.frame_offset(50)
    unlimited = resource.prlimit(writer.process.pid, resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    wait_for(lambda: "no space" in writer.errors, "the full disk")
    assert_what_was_acked_is_there(bench, 100)
    assert max(bench.acked()) < 50
    resource.prlimit(writer.process.pid, resource.RLIMIT_FSIZE, unlimited)
    assert camera.result()["nacks"]["no space"] > 0
    assert_file_equals_witness(bench, 100)
