"""One scan in the worker, without sockets: poison, silence, late truth, unusable calibrations."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from acquire.contract.messaging.messages import End
from acquire.contract.states import Outcome
from process.fold.fold import Fold
from process.results.reconstruct import reconstruct
from process.results.settings import ReconstructOptions, Recorded
from process.worker.live_scan import SILENT_NS, LiveScan
from process.worker.scan_description import ScanDescription, ScanRefusedError
from tests.fakes.processes.sweep_source import SweepSource, edge_frames

FRAMES, WIDTH, HEIGHT = 30, 64, 48
LIMIT = 2_000_000_000


class FakeClock:
    def __init__(self) -> None:
        self.now = 1

    def now_ns(self) -> int:
        return self.now


@pytest.fixture
def source(run_dir: Path, tmp_path: Path) -> Iterator[SweepSource]:
    made = SweepSource(run_dir, tmp_path / "scan", edge_frames(FRAMES, WIDTH, HEIGHT))
    made.create()
    try:
        yield made
    finally:
        made.close()


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture
def scan(source: SweepSource, clock: FakeClock) -> Iterator[LiveScan]:
    made = LiveScan(ScanDescription.of_start(source.start_message), LIMIT, clock)
    yield made
    made.close()


def give(scan: LiveScan, source: SweepSource, index: int, **changes) -> bool:
    return scan.take_image(source.image(index, **changes), memoryview(source.frames[index].tobytes()))


def end(scan: LiveScan, source: SweepSource, outcome: Outcome = Outcome.COMPLETE) -> None:
    scan.take_end(End(scan_uid=source.scan_uid, outcome=outcome, expected=FRAMES, sent=FRAMES))
    source.file.seal(outcome)


def maps_of(folder: Path) -> dict[str, np.ndarray]:
    with h5py.File(folder / "maps.h5") as file:
        return {name: held[()] for name, held in file.items() if isinstance(held, h5py.Dataset)}


def test_a_scan_that_is_over_gives_its_memory_back_at_once(source, clock):
    gc.collect()
    gc.disable()
    try:
        scan = LiveScan(ScanDescription.of_start(source.start_message), LIMIT, clock)
        for index in range(FRAMES):
            give(scan, source, index)
            source.take(index)
        scan.fill()
        while scan.may_fit_early:
            scan.fit_early()
        end(scan, source)
        scan.finish()
        scan.close()
        gone = [weakref.ref(scan), weakref.ref(scan.cursor.fold)]
        del scan
        assert [ref() for ref in gone] == [None, None]
    finally:
        gc.enable()


def test_a_frame_that_raises_is_folded_again_from_the_file_with_the_same_result(
    scan, source, tmp_path, monkeypatch, caplog
):
    add, poison = Fold.add, [12]

    def poisoned(self, frame_index, frame, **options):
        if frame_index in poison:
            poison.remove(frame_index)
            raise RuntimeError("poison")
        add(self, frame_index, frame, **options)

    monkeypatch.setattr(Fold, "add", poisoned)
    for index in range(FRAMES):
        source.commit(index)
        give(scan, source, index)
    end(scan, source)
    while not scan.ready_to_finish():
        assert scan.fill()
    scan.finish()
    assert scan.check.refused.raised == 1 and scan.cursor.counts.refolded == 12
    summary = reconstruct(source.folder, ReconstructOptions(out=tmp_path / "again"))
    live, again = maps_of(source.folder), maps_of(summary.paths.folder)
    assert all(np.array_equal(live[k], again[k], equal_nan=live[k].dtype.kind == "f") for k in again)


def test_a_committed_frame_is_left_to_the_live_lane_for_a_moment_then_read(scan, source, clock):
    source.commit(0)
    clock.now += SILENT_NS + 1
    assert scan.wants_file and scan.fill() == 0, "it may still be on its way"
    clock.now += SILENT_NS - 1
    assert scan.fill() == 0
    clock.now += 1
    assert scan.fill() == 1 and scan.cursor.next_index == 1


def test_the_silent_lane_does_not_make_it_read_what_is_not_committed(scan, clock):
    clock.now += 10 * SILENT_NS
    assert scan.fill() == 0 and scan.cursor.next_index == 0


def test_results_are_ready_as_soon_as_all_frames_are_folded_and_committed(scan, source):
    for index in range(FRAMES):
        give(scan, source, index)
    assert not scan.ready_to_finish(), "nothing is committed yet"
    for index in range(FRAMES):
        source.commit(index)
    assert scan.ready_to_finish()
    assert scan.finish().report.outcome == "running"


def test_outcome_and_truth_enter_the_report_when_they_are_known(scan, source):
    for index in range(FRAMES):
        source.commit(index)
        give(scan, source, index)
    results = scan.finish()
    assert results.report.truth is None and not scan.refresh()
    end(scan, source, Outcome.COMPLETE)
    shape = (HEIGHT, WIDTH)
    with h5py.File(source.folder / "truth.h5", "w") as file:
        file["points"] = results.cloud.points_mm.reshape(-1, 3)[:1].repeat(WIDTH * HEIGHT, axis=0).reshape(*shape, 3)
        file["visible"], file["amplitude"] = np.ones(shape, np.uint8), np.full(shape, 160.0)
    assert scan.refresh()
    assert scan.results.report.outcome == "complete"
    assert scan.results.report.truth.visible_over_contrast == WIDTH * HEIGHT
    assert not scan.refresh(), "nothing new"


def test_a_calibration_that_cannot_be_used_costs_the_cloud_and_says_so(source):
    announced = ScanDescription.of_start(source.start_message)
    recorded = Recorded(
        announced.recorded.format,
        config_toml="[reconstruct]\ncontrast = 61\n",
        calibration_json=announced.recorded.calibration_json.replace("77", "NaN"),
    )
    found = LiveScan(replace(announced, recorded=recorded), LIMIT)
    assert found.settings.calibration is None and found.settings.contrast == 61
    assert "no cloud" in found.progress().message and "NaN" in found.progress().message
    found.close()


def test_a_fold_beyond_the_limit_is_refused_before_any_memory_is_taken(source):
    with pytest.raises(ScanRefusedError, match=r"limits.fold_bytes allows 10.0 kB"):
        LiveScan(ScanDescription.of_start(source.start_message), 10_000)


@pytest.mark.parametrize(
    "changes",
    [
        {"shape": [HEIGHT, WIDTH, 3]},
        {"dtype": "<u2"},
        {"bit_depth": 9},
        {"pixel_format": "bayer_rggb"},
        {"frame_index": FRAMES},
        {"crc32": 0},
        {"scan_uid": "other"},
        {"role": "dark"},
    ],
)
def test_a_live_frame_that_does_not_fit_is_ignored(scan, source, changes):
    assert not scan.take_image(source.image(0, **changes), memoryview(source.frames[0].tobytes()))
    assert scan.cursor.next_index == 0


def test_a_provisional_point_settles_when_its_pixel_has_not_got_brighter_for_a_while(scan, source):
    for index in range(FRAMES - 1):
        give(scan, source, index)
    early = scan.preview()
    assert early.counts.provisional > 0 and early.counts.settled > 0
    give(scan, source, FRAMES - 1)
    assert scan.preview().counts.provisional == 0
