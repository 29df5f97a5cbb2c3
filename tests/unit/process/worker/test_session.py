"""One scan in the worker, without sockets: poison, silence, late truth, unusable calibrations."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from acquire.contract.messaging.messages import End
from acquire.contract.states import Outcome
from process.fold.fold import Fold
from process.results.reconstruct import reconstruct
from process.results.settings import ReconstructOptions
from process.worker import session as session_module
from process.worker.scan_description import ScanRefusedError, announced_by_start
from process.worker.session import SILENT_NS, ScanSession
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
def session(source: SweepSource, clock: FakeClock) -> Iterator[ScanSession]:
    made = ScanSession(announced_by_start(source.start_message), LIMIT, clock)
    yield made
    made.close()


def give(session: ScanSession, source: SweepSource, index: int, **changes) -> bool:
    return session.take_image(source.image(index, **changes), memoryview(source.frames[index].tobytes()))


def end(session: ScanSession, source: SweepSource, outcome: Outcome = Outcome.COMPLETE) -> None:
    session.take_end(End(scan_uid=source.scan_uid, outcome=outcome, expected=FRAMES, sent=FRAMES))
    source.file.seal(outcome)


def maps_of(folder: Path) -> dict[str, np.ndarray]:
    with h5py.File(folder / "maps.h5") as file:
        return {name: file[name][()] for name in file}


def test_a_scan_that_is_over_gives_its_memory_back_at_once(source, clock):
    gc.collect()
    gc.disable()
    try:
        session = ScanSession(announced_by_start(source.start_message), LIMIT, clock)
        for index in range(FRAMES):
            give(session, source, index)
            source.take(index)
        session.fill()
        while session.may_work_ahead:
            session.work_ahead()
        end(session, source)
        session.finish()
        session.close()
        gone = [weakref.ref(session), weakref.ref(session.cursor.fold)]
        del session
        assert [ref() for ref in gone] == [None, None]
    finally:
        gc.enable()


def test_a_frame_that_raises_is_folded_again_from_the_file_with_the_same_result(
    session, source, tmp_path, monkeypatch, caplog
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
        give(session, source, index)
    end(session, source)
    while not session.ready_to_finish():
        assert session.fill()
    session.finish()
    assert session.gate.counts.raised == 1 and session.cursor.counts.refolded == 12
    summary = reconstruct(source.folder, ReconstructOptions(out=tmp_path / "again"))
    live, again = maps_of(source.folder), maps_of(summary.paths.folder)
    assert all(np.array_equal(live[k], again[k], equal_nan=live[k].dtype.kind == "f") for k in again)


def test_a_committed_frame_is_left_to_the_live_lane_for_a_moment_then_read(session, source, clock):
    source.commit(0)
    clock.now += SILENT_NS + 1
    assert session.wants_file and session.fill() == 0, "it may still be on its way"
    clock.now += SILENT_NS - 1
    assert session.fill() == 0
    clock.now += 1
    assert session.fill() == 1 and session.cursor.next_index == 1


def test_the_silent_lane_does_not_make_it_read_what_is_not_committed(session, clock):
    clock.now += 10 * SILENT_NS
    assert session.fill() == 0 and session.cursor.next_index == 0


def test_results_are_ready_as_soon_as_all_frames_are_folded_and_committed(session, source):
    for index in range(FRAMES):
        give(session, source, index)
    assert not session.ready_to_finish(), "nothing is committed yet"
    for index in range(FRAMES):
        source.commit(index)
    assert session.ready_to_finish()
    assert session.finish().report.outcome == "running"


def test_outcome_and_truth_enter_the_report_when_they_are_known(session, source):
    for index in range(FRAMES):
        source.commit(index)
        give(session, source, index)
    results = session.finish()
    assert results.report.truth is None and not session.refresh()
    end(session, source, Outcome.COMPLETE)
    shape = (HEIGHT, WIDTH)
    with h5py.File(source.folder / "truth.h5", "w") as file:
        file["points"] = results.cloud.points_mm.reshape(-1, 3)[:1].repeat(WIDTH * HEIGHT, axis=0).reshape(*shape, 3)
        file["visible"], file["amplitude"] = np.ones(shape, np.uint8), np.full(shape, 160.0)
    assert session.refresh()
    assert session.results.report.outcome == "complete"
    assert session.results.report.truth.visible_over_contrast == WIDTH * HEIGHT
    assert not session.refresh(), "nothing new"


def test_a_calibration_that_cannot_be_used_costs_the_cloud_and_says_so(source):
    announced = announced_by_start(source.start_message)
    damaged = announced.recorded.calibration_json.replace("77", "NaN")
    recorded = session_module.Announced(
        announced.scan_uid,
        announced.folder,
        announced.count,
        type(announced.recorded)(announced.recorded.format, config_toml="[reconstruct]\ncontrast = 61\n",
                                 calibration_json=damaged),
    )  # fmt: skip
    found = ScanSession(recorded, LIMIT)
    assert found.settings.calibration is None and found.settings.contrast == 61
    assert "no cloud" in found.progress(0).message and "NaN" in found.progress(0).message
    found.close()


def test_a_fold_beyond_the_limit_is_refused_before_any_memory_is_taken(source):
    with pytest.raises(ScanRefusedError, match=r"limits.fold_bytes allows 10.0 kB"):
        ScanSession(announced_by_start(source.start_message), 10_000)


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
def test_a_live_frame_that_does_not_fit_is_ignored(session, source, changes):
    assert not session.take_image(source.image(0, **changes), memoryview(source.frames[0].tobytes()))
    assert session.cursor.next_index == 0


def test_a_provisional_point_settles_when_its_pixel_has_not_got_brighter_for_a_while(session, source):
    for index in range(FRAMES - 1):
        give(session, source, index)
    early = session.preview()
    assert early.counts.provisional > 0 and early.counts.settled > 0
    give(session, source, FRAMES - 1)
    assert session.preview().counts.provisional == 0
