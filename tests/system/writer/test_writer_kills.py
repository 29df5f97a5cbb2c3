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
import importlib, os, signal, sys
from pathlib import Path
from acquire.contract.config.load import load_config
from acquire.writer.service import run_writer

def die_at(module, name, nth, when):
    owner = importlib.import_module(module)
    for part in name.split(".")[:-1]:
        owner = getattr(owner, part)
    name, calls = name.split(".")[-1], []
    real = getattr(owner, name)
    def call(*args):
        calls.append(1)
        if len(calls) == nth and when == "half":
            real(args[0], args[1][: len(args[1]) // 2], *args[2:])
        if len(calls) == nth and when != "after":
            os.kill(os.getpid(), signal.SIGKILL)
        found = real(*args)
        if len(calls) == nth:
            os.kill(os.getpid(), signal.SIGKILL)
        return found
    setattr(owner, name, call)

die_at(sys.argv[2], sys.argv[3], int(sys.argv[4]), sys.argv[5])
run_writer(load_config(), Path(sys.argv[1]))
"""


@pytest.fixture
def bench(run_dir: Path, tmp_path: Path) -> Iterator[Bench]:
    with bench_at(run_dir, tmp_path) as made:
        yield made


def dying_writer(bench: Bench, module: str, name: str, nth: int, when: str) -> Child:
    """A writer that kills itself at the nth call of a function: before, after, or half-way through its data."""
    return bench.start("writer", ["-c", _DYING_WRITER, str(bench.run_dir), module, name, str(nth), when])


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
    ("module", "name", "nth", "when"),
    [
        ("acquire.writer.create_file", "_write_entry", 1, "after"),
        ("acquire.writer.scan_file", "rename_new", 1, "before"),
        ("acquire.writer.scan_file", "rename_new", 1, "after"),
    ],
)
def test_a_writer_killed_while_it_makes_the_file_is_followed_by_one_that_makes_it(
    bench: Bench, module: str, name: str, nth: int, when: str
) -> None:
    camera = bench.camera(20)
    dies(dying_writer(bench, module, name, nth, when))
    bench.writer()
    camera.result()
    assert [path.name for path in bench.scan.iterdir()] == ["scan.h5"], "no leftovers"
    assert_file_equals_witness(bench, 20)


@pytest.mark.parametrize(
    ("name", "nth", "when"),
    [("write_at", 73, "half"), ("write_at", 80, "before"), ("write_at", 81, "after")],
)
def test_a_writer_killed_within_a_frame_tears_nothing_that_counts(bench: Bench, name: str, nth: int, when: str) -> None:
    # nine writes make a frame: pixels, seven fields, status; the 73rd is the pixels of frame 8
    camera = bench.camera(20)
    dies(dying_writer(bench, "acquire.writer.frame_store", name, nth, when))
    assert_what_was_acked_is_there(bench, 20)
    with ScanReader(bench.scan) as reader:
        assert reader.status()[8] == (1 if nth == 81 else 0)
    bench.writer()
    camera.result()
    assert_file_equals_witness(bench, 20)


@pytest.mark.parametrize(
    ("module", "name", "nth", "when"),
    [
        ("acquire.writer.scan_file", "ScanFile.check_frames", 1, "before"),
        ("acquire.writer.scan_file", "ScanFile._put_outcome", 1, "after"),
        ("acquire.writer.scan_file", "rename_new", 2, "before"),
        ("acquire.writer.scan_file", "rename_new", 2, "after"),
    ],
)
def test_a_writer_killed_while_it_seals_is_followed_by_one_that_seals(
    bench: Bench, module: str, name: str, nth: int, when: str
) -> None:
    camera = bench.camera(20)
    dies(dying_writer(bench, module, name, nth, when))
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
