"""Folders of pictures become scans, or are refused by the name of the picture that does not fit."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.scan_data.reader import ScanReader
from acquire.importing.folder import import_folder
from acquire.pictures.sequence import Asked
from acquire.writer.verify import info, verify

RNG = np.random.default_rng(3)


def grey(bits: int = 8, shape: tuple[int, ...] = (12, 17)) -> NDArray[np.generic]:
    return RNG.integers(0, 1 << bits, shape).astype(np.uint8 if bits == 8 else np.uint16)


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    folder = tmp_path / "frames"
    folder.mkdir()
    return folder


def save(folder: Path, name: str, pixels: NDArray[np.generic]) -> NDArray[np.generic]:
    assert cv2.imwrite(str(folder / name), pixels)
    return pixels


def refused(frames: Path, target: Path, words: str, **options: Any) -> str:
    before = sorted(target.parent.iterdir())
    with pytest.raises(ScanFileError, match=words) as error:
        import_folder(frames, target, **options)
    assert "\n" not in str(error.value)
    assert sorted(target.parent.iterdir()) == before, "a refused import leaves nothing behind"
    return str(error.value)


@pytest.mark.parametrize("suffix", ["png", "bmp", "tif"])
def test_grey_pictures_are_imported_bit_for_bit(frames: Path, tmp_path: Path, suffix: str) -> None:
    saved = [save(frames, f"{index}.{suffix}", grey()) for index in range(9)]
    summary = import_folder(frames, tmp_path / "scan.h5")
    assert (summary.frames, summary.first_frame, summary.last_frame) == (9, f"0.{suffix}", f"8.{suffix}")
    with ScanReader(tmp_path / "scan.h5") as reader:
        assert all(np.array_equal(reader.frame(index), pixels) for index, pixels in enumerate(saved))


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_sixteen_bits_are_kept(frames: Path, tmp_path: Path, suffix: str) -> None:
    saved = save(frames, f"0.{suffix}", grey(16))
    assert import_folder(frames, tmp_path / "scan.h5").format.bit_depth == 16
    with ScanReader(tmp_path / "scan.h5") as reader:
        assert np.array_equal(reader.frame(0), saved)


def test_colour_is_stored_as_rgb(frames: Path, tmp_path: Path) -> None:
    saved = save(frames, "0.png", grey(shape=(12, 17, 3)))
    assert import_folder(frames, tmp_path / "scan.h5").format.pixel_format == "rgb"
    with ScanReader(tmp_path / "scan.h5") as reader:
        assert np.array_equal(reader.frame(0), saved[..., ::-1])


def test_what_cannot_be_known_is_marked_as_unknown(frames: Path, tmp_path: Path) -> None:
    save(frames, "0.png", grey())
    import_folder(frames, tmp_path / "scan.h5")
    with ScanReader(tmp_path / "scan.h5") as reader:
        assert np.isnan(reader.field("position_um")).all()
        assert (reader.field("trigger_id")[0], reader.field("camera_frame_id")[0]) == (-1, -1)
        assert (reader.field("exposure_start_ns")[0], reader.status()[0]) == (0, 1)
        assert (reader.layout.purpose, reader.layout.plan) == ("raw", None)


def test_the_axis_of_an_imported_scan_is_the_frame_number_from_one(frames: Path, tmp_path: Path) -> None:
    for index in range(3):
        save(frames, f"{index}.png", grey())
    import_folder(frames, tmp_path / "scan.h5")
    with h5py.File(tmp_path / "scan.h5") as file:
        assert file["/entry/data"].attrs["axes"][0] == b"frame_number"
        assert file["/entry/data/frame_number"][:].tolist() == [1, 2, 3]


def test_an_imported_scan_is_sealed_and_sound(frames: Path, tmp_path: Path) -> None:
    save(frames, "0.png", grey())
    import_folder(frames, tmp_path / "scan.h5")
    assert verify(tmp_path / "scan.h5").complete
    assert sorted(path.name for path in tmp_path.iterdir()) == ["frames", "scan.h5"]


@pytest.mark.parametrize("odd", [grey(shape=(12, 18)), grey(16), grey(shape=(12, 17, 3))])
def test_all_pictures_that_differ_are_named_at_once(frames: Path, tmp_path: Path, odd: NDArray[np.generic]) -> None:
    for index in range(8):
        save(frames, f"{index}.png", np.roll(odd, index) if index in (0, 5) else grey())
    assert "0.png, 5.png are" in refused(frames, tmp_path / "scan.h5", "all frames must be alike")


@pytest.mark.parametrize("content", [b"this is a text\n", b"", b"\x89PNG\r\n\x1a\n torn"])
def test_a_text_file_called_png_is_named(frames: Path, tmp_path: Path, content: bytes) -> None:
    save(frames, "0.png", grey())
    (frames / "1.png").write_bytes(content)
    assert "1.png" in refused(frames, tmp_path / "scan.h5", "no readable picture|is empty")


def test_a_picture_with_float_values_is_named(frames: Path, tmp_path: Path) -> None:
    save(frames, "0.tif", grey().astype(np.float32))
    assert "0.tif" in refused(frames, tmp_path / "scan.h5", "8 or 16 bits")


def test_a_file_with_several_pictures_is_named(frames: Path, tmp_path: Path) -> None:
    assert cv2.imwritemulti(str(frames / "0.tif"), [grey(), grey()])
    save(frames, "1.tif", grey())
    assert "0.tif" in refused(frames, tmp_path / "scan.h5", "several pictures")


def test_a_folder_without_pictures_is_refused(frames: Path, tmp_path: Path) -> None:
    (frames / "readme.txt").write_text("nothing")
    refused(frames, tmp_path / "scan.h5", "holds no pictures")


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    refused(tmp_path / "nowhere", tmp_path / "scan.h5", "cannot be read")


def test_an_existing_target_stays_unless_forced(frames: Path, tmp_path: Path) -> None:
    save(frames, "0.png", grey())
    (tmp_path / "scan.h5").write_bytes(b"precious")
    refused(frames, tmp_path / "scan.h5", "--force")
    assert (tmp_path / "scan.h5").read_bytes() == b"precious"
    import_folder(frames, tmp_path / "scan.h5", force=True)
    assert verify(tmp_path / "scan.h5").complete


def test_a_forced_import_that_fails_leaves_the_old_target(frames: Path, tmp_path: Path) -> None:
    save(frames, "0.png", grey())
    save(frames, "1.png", grey(16))
    (tmp_path / "scan.h5").write_bytes(b"precious")
    refused(frames, tmp_path / "scan.h5", "alike", force=True)
    assert (tmp_path / "scan.h5").read_bytes() == b"precious"


def test_a_target_without_a_suffix_is_refused_with_what_is_expected(frames: Path, tmp_path: Path) -> None:
    save(frames, "0.png", grey())
    refused(frames, tmp_path / "scan", "give the .h5 to make")


def test_a_target_in_a_folder_that_is_not_there_is_refused(frames: Path, tmp_path: Path) -> None:
    save(frames, "0.png", grey())
    with pytest.raises(ScanFileError, match="does not exist"):
        import_folder(frames, tmp_path / "nowhere" / "scan.h5")


def original_folder(frames: Path, pictures: int, last_frame: int) -> None:
    for index in range(pictures):
        save(frames, f"frame{index + 1:04d}.bmp", grey())
    clicks = f"Frame 1 \t412 300\nFrame {last_frame} \t880 310\nCalibration Corners: \t1 2 \t 3 4 \t 5 6\n"
    (frames / "projector.txt").write_text(clicks)


def test_a_folder_of_the_original_program_has_positions(frames: Path, tmp_path: Path) -> None:
    original_folder(frames, 5, 5)
    summary = import_folder(frames, tmp_path / "scan.h5")
    with ScanReader(tmp_path / "scan.h5") as reader:
        assert reader.field("position_um") == pytest.approx(np.arange(5) * 9.525)
    assert "3 microsteps of 3.175 um a frame" in summary.words()


def test_where_pictures_of_the_original_program_are_missing_positions_are_not_known(
    frames: Path, tmp_path: Path
) -> None:
    original_folder(frames, 4, 5)
    summary = import_folder(frames, tmp_path / "scan.h5")
    with ScanReader(tmp_path / "scan.h5") as reader:
        assert np.isnan(reader.field("position_um")).all()
    assert "speaks of 5 frames and there are 4: positions are not known" in summary.words()


def test_the_travel_per_frame_can_be_given(frames: Path, tmp_path: Path) -> None:
    original_folder(frames, 3, 3)
    import_folder(frames, tmp_path / "scan.h5", um_per_frame=-2.5)
    with ScanReader(tmp_path / "scan.h5") as reader:
        assert reader.field("position_um") == pytest.approx([0.0, -2.5, -5.0])


def test_a_gap_is_refused_with_its_place_and_the_options(frames: Path, tmp_path: Path) -> None:
    for index in (0, 1, 2, 4, 5):
        save(frames, f"frame_{index:04d}.png", grey())
    text = refused(frames, tmp_path / "scan.h5", "frame_0003 is missing between frame_0002 and frame_0004")
    assert "--missing-as-missing" in text and "--as-is" in text


def test_missing_pictures_become_missing_frames_and_the_scan_is_not_complete(frames: Path, tmp_path: Path) -> None:
    saved = {index: save(frames, f"{index}.png", grey()) for index in (1, 2, 4, 5)}
    (frames / "3.png").write_bytes(b"torn")
    (frames / "7.png").write_bytes(b"")
    asked = Asked(missing_as_missing=True)
    summary = import_folder(frames, tmp_path / "scan.h5", um_per_frame=10.0, asked=asked)
    assert (summary.frames, summary.expected, summary.complete) == (4, 7, False) and "6 is missing" in summary.missing
    with ScanReader(tmp_path / "scan.h5") as reader:
        assert reader.status().tolist() == [1, 1, 0, 1, 1, 0, 0]
        assert np.array_equal(reader.frame(3), saved[4])
        assert reader.field("position_um") == pytest.approx(10.0 * np.arange(7))
    report = verify(tmp_path / "scan.h5")
    assert report.ok and not report.complete and report.outcome == "stopped" and "SAVED" not in report.words()[1]


def test_as_is_takes_what_is_there_in_natural_order(frames: Path, tmp_path: Path) -> None:
    saved = [save(frames, name, grey()) for name in ("a2.png", "a10.png", "b.png")]
    summary = import_folder(frames, tmp_path / "scan.h5", asked=Asked(as_is=True))
    assert summary.complete and "nothing proves" in summary.note
    with ScanReader(tmp_path / "scan.h5") as reader:
        assert all(np.array_equal(reader.frame(index), pixels) for index, pixels in enumerate(saved))


def test_one_of_two_series_is_chosen_by_its_pattern(frames: Path, tmp_path: Path) -> None:
    for index in range(3):
        save(frames, f"left_{index}.png", grey())
        save(frames, f"right_{index}.png", grey())
    assert "'left_*.png' or 'right_*.png'" in refused(frames, tmp_path / "scan.h5", "2 series")
    summary = import_folder(frames, tmp_path / "scan.h5", asked=Asked(pattern="LEFT_*.png"))
    assert (summary.frames, summary.first_frame, summary.last_frame) == (3, "left_0.png", "left_2.png")
    refused(frames, tmp_path / "other.h5", "fits --pattern", asked=Asked(pattern="middle_*"))


def test_the_files_that_a_scan_was_made_of_are_kept_in_it(frames: Path, tmp_path: Path) -> None:
    for index in range(3):
        save(frames, f"{index}.png", grey())
    import_folder(frames, tmp_path / "scan.h5")
    found = info(tmp_path / "scan.h5").sources
    assert found is not None and found.folder == str(frames) and found.numbers == "numbers 0 to 2"
    for index, file in enumerate(found.files):
        content = (frames / f"{index}.png").read_bytes()
        assert (file.text, file.size_bytes) == (f"{index}.png", len(content))
        assert file.sha256 == hashlib.sha256(content).hexdigest()
    assert found.checksum_lines()[1] == f"{found.files[1].sha256}  1.png".encode()


def test_a_scan_without_source_files_is_read_as_before(frames: Path, tmp_path: Path) -> None:
    save(frames, "0.png", grey())
    import_folder(frames, tmp_path / "scan.h5")
    with h5py.File(tmp_path / "scan.h5", "r+") as file:
        del file["entry/sources"]
    assert info(tmp_path / "scan.h5").sources is None


def test_names_that_are_no_utf_8_do_no_harm(frames: Path, tmp_path: Path) -> None:
    for index in range(3):
        save(frames, f"{index}.png", grey())
        (frames / f"{index}.png").rename(frames / os.fsdecode(b"view\xff\n%d.png" % index))
    summary = import_folder(frames, tmp_path / "scan.h5")
    assert summary.words().isprintable() and summary.first_frame == r"view\xff\n0.png"
    found = info(tmp_path / "scan.h5").sources
    assert found is not None and found.files[2].name == b"view\xff\n2.png"


def test_a_stack_is_a_sequence_of_its_pages(frames: Path, tmp_path: Path) -> None:
    saved = [grey(16) for _ in range(5)]
    assert cv2.imwritemulti(str(frames / "stack.tif"), saved)
    for place in (frames, frames / "stack.tif"):
        assert import_folder(place, tmp_path / "scan.h5", force=True).numbers == "pages 1 to 5 of stack.tif"
        with ScanReader(tmp_path / "scan.h5") as reader:
            assert all(np.array_equal(reader.frame(index), pixels) for index, pixels in enumerate(saved))


@pytest.mark.parametrize("factor", [1, 16, 256, 257])
def test_eight_bits_in_sixteen_give_the_scan_of_eight_bits(frames: Path, tmp_path: Path, factor: int) -> None:
    saved = [grey() for _ in range(3)]
    for index, pixels in enumerate(saved):
        save(frames, f"{index}.tif", pixels.astype(np.uint16) * factor)
    summary = import_folder(frames, tmp_path / "scan.h5")
    assert summary.format.bit_depth == 8 and "taken for 8 bit" in summary.note
    with ScanReader(tmp_path / "scan.h5") as reader:
        assert all(np.array_equal(reader.frame(index), pixels) for index, pixels in enumerate(saved))


def test_a_depth_that_was_asked_for_is_taken_or_refused(frames: Path, tmp_path: Path) -> None:
    save(frames, "0.png", grey(12))
    assert import_folder(frames, tmp_path / "scan.h5", asked=Asked(bit_depth=14)).format.bit_depth == 14
    refused(frames, tmp_path / "other.h5", "more than 10 bit have", asked=Asked(bit_depth=10))
