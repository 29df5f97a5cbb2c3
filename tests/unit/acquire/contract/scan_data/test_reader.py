"""The reader of scan files: whatever else holds the file, and whatever is wrong with it."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

from acquire.contract.errors import ScanFileError
from acquire.contract.scan_data.checksums import frame_crc32
from acquire.contract.scan_data.file_layout import read_layout
from acquire.contract.scan_data.reader import ScanReader
from acquire.writer.scan_file import create_scan
from tests.fakes.scans.frames import image_of, pixels_of, start_of


@pytest.fixture
def scan(tmp_path):
    start = start_of(tmp_path / "scan", 4)
    file = create_scan(tmp_path / "scan", start)
    pixels = pixels_of(0, 4, start.format)
    file.write_frame(image_of(0, pixels, start), pixels)
    yield file, pixels
    file.close()


def test_each_commit_is_seen_at_once_by_a_reader_that_was_open_before(scan, tmp_path):
    file, _pixels = scan
    start = start_of(tmp_path / "scan", 4)
    with ScanReader(file.path) as reader:
        assert reader.committed_through() == 0
        pixels = pixels_of(1, 4, start.format)
        file.write_frame(image_of(1, pixels, start), pixels)
        assert reader.committed_through() == 1
        assert np.array_equal(reader.frame(1), pixels) and frame_crc32(reader.frame(1)) == reader.field("crc32")[1]


def test_a_file_that_this_process_holds_open_with_h5py_can_be_read_all_the_same(scan):
    file, pixels = scan
    with h5py.File(file.path, "r"), ScanReader(file.path) as reader:
        assert np.array_equal(reader.frame(0), pixels)


def test_a_scan_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ScanFileError, match="does not exist"):
        read_layout(tmp_path / "away")
    with pytest.raises(ScanFileError, match="it is no scan"):
        read_layout(tmp_path)


@pytest.mark.parametrize("size", [0, 10, 3000])
def test_a_file_that_was_cut_short_is_refused(scan, tmp_path, size):
    cut = tmp_path / "cut.h5"
    cut.write_bytes(scan[0].path.read_bytes()[:size])
    with pytest.raises(ScanFileError, match=r"cut\.h5"):
        read_layout(cut)


def test_a_frame_beyond_the_plan_is_an_index_error(scan):
    with ScanReader(scan[0].path) as reader, pytest.raises(IndexError):
        reader.frame(4)
