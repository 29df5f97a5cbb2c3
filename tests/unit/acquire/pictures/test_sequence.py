"""Pictures are proven to be one sequence, or refused with everything that speaks against it."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from acquire.contract.errors import ScanFileError
from acquire.pictures.sequence import Asked, UnprovenError, prove_sequence

RNG = np.random.default_rng(8)
START = datetime(2021, 3, 4, 12, 0, 0)


def write(folder: Path, names: list[str], seed: int = 0) -> None:
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(seed)
    for name in names:
        cv2.imwrite(str(folder / name), rng.integers(0, 255, (12, 16)).astype(np.uint8))


def with_times(folder: Path, seconds: list[float], tag: int = 36867) -> None:
    for index, second in enumerate(seconds):
        when, exif = START + timedelta(seconds=second), Image.Exif()
        where = exif if tag == 306 else exif.get_ifd(0x8769)
        where[tag] = f"{when:%Y:%m:%d %H:%M:%S}"
        if tag != 306:
            where[37521] = f"{when.microsecond // 1000:03d}"
        pixels = RNG.integers(0, 255, (12, 16)).astype(np.uint8)
        Image.fromarray(pixels).save(folder / f"{index}.jpg", exif=exif)


def test_a_folder_of_one_series_is_a_sequence(tmp_path):
    write(tmp_path, [f"f{k}.png" for k in range(8, 13)])
    found = prove_sequence(tmp_path)
    assert (len(found.frames), found.missing, found.notes, found.pattern) == (5, "", (), "f#.png")
    assert np.array_equal(found.read(2), cv2.imread(str(tmp_path / "f10.png"), -1))


def test_everything_against_a_sequence_is_told_at_once(tmp_path):
    write(tmp_path, [f"f{k}.png" for k in range(12) if k != 3])
    (tmp_path / "f5.png").write_bytes(b"no")
    (tmp_path / "f7.png").write_bytes(b"")
    cv2.imwrite(str(tmp_path / "f9.png"), np.zeros((12, 17), np.uint8))
    with pytest.raises(UnprovenError) as error:
        prove_sequence(tmp_path)
    for said in ("f3 is missing between f2 and f4", "f5.png is no readable", "f7.png is empty", "f9.png is 17 x 12"):
        assert said in str(error.value)
    assert "nothing was written" in str(error.value) and "\n" not in str(error.value)


def test_a_picture_that_is_there_several_times_in_a_row_is_said_or_becomes_missing(tmp_path):
    write(tmp_path, [f"f{k}.png" for k in range(9)])
    for k in (4, 5):
        (tmp_path / f"f{k}.png").write_bytes((tmp_path / "f3.png").read_bytes())
    found = prove_sequence(tmp_path)
    assert all(found.frames) and "SUSPICIOUS: f3.png to f5.png are the same picture 3 times" in found.notes[0]
    assert "SUSPICIOUS" in " ".join(prove_sequence(tmp_path, Asked(as_is=True)).notes)
    found = prove_sequence(tmp_path, Asked(missing_as_missing=True))
    assert [look is None for look in found.frames] == [False] * 4 + [True] * 2 + [False] * 3


def test_pictures_that_are_the_same_at_an_end_are_said_only(tmp_path):
    write(tmp_path, [f"f{k}.png" for k in range(5)])
    (tmp_path / "f1.png").write_bytes((tmp_path / "f0.png").read_bytes())
    found = prove_sequence(tmp_path)
    assert all(found.frames) and "same picture" in found.notes[0]


@pytest.mark.parametrize("seconds", [[4, 3, 2, 1], [0, 1, 5, 4], [0.0, 0.5, 0.2, 0.9]])
def test_a_cameras_times_against_the_numbers_are_refused(tmp_path, seconds):
    with_times(tmp_path, seconds)
    with pytest.raises(UnprovenError, match="times and numbers disagree"):
        prove_sequence(tmp_path)
    assert all(prove_sequence(tmp_path, Asked(as_is=True)).frames)


@pytest.mark.parametrize("seconds", [[0, 0, 0, 1], [0.1, 0.2, 0.3, 0.4], [0, 60, 3600, 90000]])
def test_times_in_the_order_of_the_numbers_are_no_matter(tmp_path, seconds):
    with_times(tmp_path, seconds)
    assert all(prove_sequence(tmp_path).frames)


def test_times_of_another_program_may_be_off_by_a_moment_but_not_reversed(tmp_path):
    with_times(tmp_path, [0, 2, 1, 3], tag=306)
    assert all(prove_sequence(tmp_path).frames)
    with_times(tmp_path, [9, 6, 3, 0], tag=306)
    with pytest.raises(UnprovenError, match="disagree"):
        prove_sequence(tmp_path)


def test_times_of_the_file_system_prove_nothing(tmp_path):
    import os

    write(tmp_path, ["f1.png", "f2.png", "f3.png"])
    for k in (1, 2, 3):
        os.utime(tmp_path / f"f{k}.png", (1000 - k, 1000 - k))
    assert all(prove_sequence(tmp_path).frames)


def test_a_folder_named_like_a_frame_is_a_missing_frame_and_another_is_left_out(tmp_path):
    write(tmp_path, [f"f{k}.png" for k in range(5) if k != 2])
    (tmp_path / "thumbs.png").mkdir()
    (tmp_path / "f2.png").mkdir()
    with pytest.raises(UnprovenError, match=r"f2\.png is a folder"):
        prove_sequence(tmp_path)
    (tmp_path / "f2.png").rmdir()
    write(tmp_path, ["f2.png"], seed=1)
    assert prove_sequence(tmp_path).notes == ("left out: thumbs.png is a folder",)


def test_one_picture_is_taken_and_said(tmp_path):
    write(tmp_path, ["only.png"])
    assert "single picture" in prove_sequence(tmp_path).notes[0]


def test_tens_of_thousands_of_empty_files_are_refused_in_one_line(tmp_path):
    for k in range(20_000):
        (tmp_path / f"f{k:05d}.png").touch()
    with pytest.raises(UnprovenError, match="and 19992 more are empty") as error:
        prove_sequence(tmp_path)
    assert len(str(error.value)) < 1000


def test_two_stacks_are_not_one_sequence(tmp_path):
    pages = [RNG.integers(0, 255, (12, 16)).astype(np.uint8) for _ in range(3)]
    for name in ("a.tif", "b.tif"):
        assert cv2.imwritemulti(str(tmp_path / name), pages)
    with pytest.raises(ScanFileError, match="2 series"):
        prove_sequence(tmp_path)
    assert len(prove_sequence(tmp_path, Asked(pattern="a.tif")).frames) == 3
    (tmp_path / "b.tif").unlink()
    (tmp_path / "thumbs.png").mkdir()
    assert len(prove_sequence(tmp_path).frames) == 3


def test_a_picture_that_changes_after_it_was_looked_at_is_refused(tmp_path):
    write(tmp_path, ["f0.png", "f1.png"])
    found = prove_sequence(tmp_path)
    write(tmp_path, ["f1.png"], seed=9)
    with pytest.raises(ScanFileError, match="changed while it was read"):
        found.read(1)


def test_a_gap_that_was_filled_with_a_copy_is_said_or_both_become_missing(tmp_path):
    write(tmp_path, [f"f{k}.png" for k in range(9)])
    (tmp_path / "f6.png").write_bytes((tmp_path / "f2.png").read_bytes())
    assert "SUSPICIOUS: f2.png, f6.png are the same picture" in prove_sequence(tmp_path).notes[0]
    found = prove_sequence(tmp_path, Asked(missing_as_missing=True))
    assert [index for index, look in enumerate(found.frames) if look is None] == [2, 6]


def test_pictures_without_light_may_be_the_same(tmp_path):
    write(tmp_path, [f"f{k}.png" for k in range(9)])
    for k in (4, 8):
        (tmp_path / f"f{k}.png").write_bytes((tmp_path / "f0.png").read_bytes())
    assert all(prove_sequence(tmp_path).frames)


def test_a_gap_longer_than_what_is_there_keeps_its_length(tmp_path):
    write(tmp_path, ["f1.png", "f2.png", "f1003.png"])
    with pytest.raises(UnprovenError, match=r"f3 to f1002 \(1000 pictures\) are missing between f2 and f1003"):
        prove_sequence(tmp_path)
    assert len(prove_sequence(tmp_path, Asked(missing_as_missing=True)).frames) == 1003


def test_a_video_and_pictures_of_other_kinds_are_told_how_to_be_converted(tmp_path):
    (tmp_path / "sweep.mp4").write_bytes(b"video")
    with pytest.raises(ScanFileError, match="ffmpeg"):
        prove_sequence(tmp_path / "sweep.mp4")
    with pytest.raises(ScanFileError, match=r"1 \.mp4 files"):
        prove_sequence(tmp_path)
