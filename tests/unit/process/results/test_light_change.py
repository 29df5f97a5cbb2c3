"""Frames in another light are marked one by one, whatever became of the sweep, and so are the pixels that need them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from acquire.contract.scan_data.dataset_names import MARKS_NAME
from acquire.contract.scan_data.reader import ScanReader
from acquire.contract.states import Outcome
from acquire.writer.scan_file import create_scan
from process.results.reconstruct import reconstruct
from process.results.settings import ReconstructOptions
from tests.fakes.scans.frames import image_of, pixels_of, start_of

COUNT = 24
CHANGED_AT = 14


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A sweep whose light changed at frame 14, with frame 3 taken again after that; its end was never said."""
    start = start_of(tmp_path / "scan", COUNT)
    scan = create_scan(Path(start.path), start)
    for k in range(COUNT):
        pixels = pixels_of(k, COUNT, start.format)
        late = {"attempt": 1, "exposure_start_ns": 10**9} if k == 3 else {}
        scan.write_frame(image_of(k, pixels, start, **late), pixels)
    (tmp_path / "scan" / MARKS_NAME).write_text(json.dumps({"light_changed_at": float(CHANGED_AT)}))
    scan.seal(Outcome.STOPPED)
    scan.close()
    return tmp_path / "scan"


def test_frames_in_another_light_are_marked_by_place_and_by_time(folder):
    with ScanReader(folder) as reader:
        assert np.flatnonzero(reader.other_light()).tolist() == [3, *range(CHANGED_AT, COUNT)]


@pytest.mark.parametrize("method", ["linear", "auto"])
def test_pixels_whose_crossing_or_maximum_lies_in_another_light_have_the_bit(folder, method):
    import h5py

    report = reconstruct(folder, ReconstructOptions(method=method)).results.report
    with h5py.File(folder / "maps.h5") as maps:
        bit = (maps["quality"][()] & 256) > 0
        crossing = maps["crossing"][()]
    assert bit[crossing > CHANGED_AT - 1].all() and not bit[np.isnan(crossing)].any()
    assert report.counts["quality_other_light"] == bit.sum() > 0
    assert report.counts["frames_other_light"] == COUNT - CHANGED_AT + 1


@pytest.mark.parametrize("text", ["", "nonsense", "[1, 2]", '{"light_changed_at": 1e300}', '{"light_changed_at": -5}'])
def test_marks_that_make_no_sense_mark_nothing(folder, text):
    (folder / MARKS_NAME).write_text(text)
    with ScanReader(folder) as reader:
        assert not reader.other_light().any()
