"""Folders of pictures become scans, or are refused by the name of the picture that does not fit."""

from __future__ import annotations

from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from acquire.cameras.image_files import list_pictures
from acquire.contract.errors import ScanFileError
from acquire.contract.scan_data.reader import ScanReader
from acquire.importing.folder import import_folder
from acquire.writer.verify import verify

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


def refused(frames: Path, target: Path, words: str, **options: bool) -> str:
    before = sorted(target.parent.iterdir())
    with pytest.raises(ScanFileError, match=words) as error:
        import_folder(frames, target, **options)
    assert "\n" not in str(error.value)
    assert sorted(target.parent.iterdir()) == before, "a refused import leaves nothing behind"
    return str(error.value)


def test_pictures_come_in_natural_order(frames: Path) -> None:
    for name in ("f10.png", "f2.PNG", "f1.jpg", "notes.txt", ".hidden.png"):
        (frames / name).write_bytes(b"x")
    assert [path.name for path in list_pictures(frames)] == ["f1.jpg", "f2.PNG", "f10.png"]


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
def test_the_first_picture_that_differs_is_named(frames: Path, tmp_path: Path, odd: NDArray[np.generic]) -> None:
    for index in range(8):
        save(frames, f"{index}.png", odd if index in (5, 6) else grey())
    assert "5.png" in refused(frames, tmp_path / "scan.h5", "all frames must be alike")


@pytest.mark.parametrize("content", [b"this is a text\n", b"", b"\x89PNG\r\n\x1a\n torn"])
def test_a_text_file_called_png_is_named(frames: Path, tmp_path: Path, content: bytes) -> None:
    save(frames, "0.png", grey())
    (frames / "1.png").write_bytes(content)
    assert "1.png" in refused(frames, tmp_path / "scan.h5", "no readable picture")


def test_a_picture_with_float_values_is_named(frames: Path, tmp_path: Path) -> None:
    save(frames, "0.tif", grey().astype(np.float32))
    assert "0.tif" in refused(frames, tmp_path / "scan.h5", "8 or 16 bits")


def test_a_file_with_several_pictures_is_named(frames: Path, tmp_path: Path) -> None:
    assert cv2.imwritemulti(str(frames / "0.tif"), [grey(), grey()])
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
