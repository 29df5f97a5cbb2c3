"""Verification says in words whether a scan holds what it promises."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import Start
from acquire.contract.states import Outcome
from acquire.writer.scan_file import ScanFile, create_scan
from acquire.writer.verify import in_words, info, verify
from tests.fakes.scans.frames import image_of, pixels_of, start_of

COUNT = 5


@pytest.fixture
def start(tmp_path: Path) -> Start:
    return start_of(tmp_path / "scan", COUNT)


def written(start: Start, frames: list[int], **changed: object) -> ScanFile:
    scan = create_scan(Path(start.path), start)
    for frame_index in frames:
        pixels = pixels_of(frame_index, COUNT, start.format)
        scan.write_frame(image_of(frame_index, pixels, start, **changed), pixels)
    return scan


def overwrite(path: Path, offset: int, data: bytes) -> None:
    with path.open("r+b") as file:
        file.seek(offset)
        file.write(data)


def test_a_sealed_complete_scan_is_saved(start: Start) -> None:
    scan = written(start, list(range(COUNT)))
    seal = scan.seal(Outcome.COMPLETE)
    report = verify(Path(start.path))
    assert (report.ok, report.complete, report.sealed) == (True, True, True)
    assert report.digest == report.recorded_digest == seal.digest
    assert "SAVED: 5 of 5 frames are safe" in report.words()
    scan.close()


def test_a_stopped_scan_is_sound_and_not_complete(start: Start) -> None:
    scan = written(start, [0, 1, 3])
    scan.seal(Outcome.STOPPED, "by the operator")
    report = verify(Path(start.path))
    assert (report.ok, report.complete, report.missing) == (True, False, [(2, 2), (4, 4)])
    assert "stopped: 3 of 5 frames are safe" in report.words()
    assert "missing: 2 frames (2, 4)" in report.words()
    scan.close()


def test_a_scan_that_is_being_written_is_sound_and_not_sealed(start: Start) -> None:
    scan = written(start, [0, 1])
    report = verify(Path(start.path))
    assert (report.ok, report.complete, report.sealed, report.committed) == (True, False, False, 2)
    scan.close()


def test_a_scan_that_died_between_the_last_steps_of_sealing_is_not_called_saved(start: Start) -> None:
    scan = written(start, list(range(COUNT)))
    sealed = scan.seal(Outcome.COMPLETE).path
    sealed.rename(sealed.with_name("scan.partial.h5"))
    report = verify(Path(start.path))
    assert not report.complete
    assert not any(line.startswith("SAVED") for line in report.words())
    scan.close()


def test_a_flipped_bit_is_a_problem_and_its_frame_is_named(start: Start) -> None:
    scan = written(start, list(range(COUNT)))
    path = scan.seal(Outcome.COMPLETE).path
    overwrite(path, scan.layout.frame_offset(2) + 100, b"\xff\x00\xff")
    report = verify(path)
    assert (report.ok, report.complete, report.wrong_crc) == (False, False, [(2, 2)])
    assert any("1 frame (2)" in problem for problem in report.problems)
    scan.close()


def test_a_changed_checksum_shows_in_the_digest(start: Start) -> None:
    scan = written(start, list(range(COUNT)))
    path = scan.seal(Outcome.COMPLETE).path
    other = pixels_of(2, COUNT, start.format, seed=8)
    overwrite(path, scan.layout.frame_offset(2), other.tobytes())
    crc32 = np.uint32(image_of(2, other, start).crc32)
    overwrite(path, scan.layout.regions["crc32"].offset + 8, crc32.tobytes())
    assert any("digest" in problem for problem in verify(path).problems)
    scan.close()


def test_a_frame_that_lost_its_status_is_a_problem_of_a_complete_scan(start: Start) -> None:
    scan = written(start, list(range(COUNT)))
    path = scan.seal(Outcome.COMPLETE).path
    overwrite(path, scan.layout.regions["status"].offset + 1, b"\0")
    report = verify(path)
    assert not report.ok
    assert any("calls itself complete" in problem for problem in report.problems)
    scan.close()


def test_a_damaged_check_frame_is_a_problem(start: Start) -> None:
    scan = written(start, [])
    dark = pixels_of(0, COUNT, start.format)
    scan.write_frame(image_of(0, dark, start, role="dark"), dark)
    assert verify(scan.path).ok
    overwrite(scan.path, scan.layout.regions["checks/data"].offset, b"\xff\xff\xff\xff")
    assert verify(scan.path).wrong_checks == ["dark"]
    scan.close()


def test_the_report_is_plain_values_for_json(start: Start) -> None:
    scan = written(start, [0], attempt=1)
    values = verify(scan.path).as_dict()
    assert (values["ok"], values["complete"], values["retaken"]) == (True, False, [(0, 0)])
    scan.close()


def test_something_that_is_no_scan_is_refused(tmp_path: Path) -> None:
    (tmp_path / "scan.h5").write_text("no HDF5")
    with pytest.raises(ScanFileError, match="not a readable scan"):
        verify(tmp_path)


def test_info_repeats_what_the_scan_says_about_itself(start: Start) -> None:
    scan = written(start, [0, 1])
    found = info(Path(start.path))
    assert (found.frames, found.committed, found.outcome, found.axis) == (COUNT, 2, "running", "position_um")
    assert found.user["name"] == "fake"
    assert any("5 frames of 64 x 48 mono, 8 bit" in line for line in found.words())
    scan.close()


def test_many_ranges_are_cut_short() -> None:
    assert in_words([(index * 2, index * 2) for index in range(20)]).endswith("14, ...)")
