"""One reader of pictures: bytes first, each picture read, or named with the reason."""

from __future__ import annotations

import io
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from acquire.contract.errors import ScanFileError
from acquire.pictures.container import look_into
from acquire.pictures.listing import list_pictures, told
from acquire.pictures.reader import PictureError, read_grey, read_picture

RNG = np.random.default_rng(5)
PIXELS: NDArray[np.uint8] = RNG.integers(0, 255, (40, 30)).astype(np.uint8)


def encoded(form: str, pixels: NDArray[np.generic] = PIXELS, **options: object) -> bytes:
    held = io.BytesIO()
    Image.fromarray(pixels).save(held, form, **options)
    return held.getvalue()


def file_of(folder: Path, content: bytes, name: str = "a.png") -> Path:
    (folder / name).write_bytes(content)
    return folder / name


@pytest.mark.parametrize("form", ["PNG", "JPEG", "TIFF", "BMP"])
@pytest.mark.parametrize("kept", [0.1, 0.6, 0.99])
def test_a_picture_cut_short_is_named(tmp_path, capfd, form, kept):
    whole = encoded(form)
    with pytest.raises(PictureError, match=r"a\.png is no readable picture"):
        read_picture(file_of(tmp_path, whole[: int(kept * len(whole))]))
    assert capfd.readouterr() == ("", ""), "no library writes to the terminal"


@pytest.mark.parametrize("form", ["PNG", "JPEG"])
def test_a_picture_whose_end_was_never_downloaded_is_named(tmp_path, form):
    whole = encoded(form)
    half = len(whole) // 2
    with pytest.raises(PictureError, match="cut short|damaged"):
        read_picture(file_of(tmp_path, whole[:half] + bytes(len(whole) - half)))


def test_a_jpeg_with_its_thumbnail_cut_short_behind_that_is_named(tmp_path):
    exif = Image.Exif()
    exif[270] = encoded("JPEG").decode("latin-1")  # holds an end marker
    whole = encoded("JPEG", exif=exif)
    assert read_picture(file_of(tmp_path, whole)).shape == (40, 30)
    with pytest.raises(PictureError, match="cut short"):
        read_picture(file_of(tmp_path, whole[:-200]))


@pytest.mark.parametrize("name", [b"view\xff1.png", b"line\n.png", b"-x.png", "\u00fcber\u65e5.png".encode()])
def test_any_name_is_read(tmp_path, name):
    path = tmp_path / os.fsdecode(name)
    path.write_bytes(encoded("PNG"))
    assert np.array_equal(read_picture(path), PIXELS) and np.array_equal(read_grey(path), PIXELS)


@pytest.mark.parametrize(
    ("mode", "form", "shape"),
    [
        ("1", "TIFF", (40, 30)),
        ("P", "PNG", (40, 30, 3)),
        ("LA", "PNG", (40, 30, 3)),
        ("RGBA", "TIFF", (40, 30, 3)),
        ("CMYK", "JPEG", (40, 30, 3)),
    ],
)
def test_unusual_kinds_of_pictures_are_read(tmp_path, mode, form, shape):
    held = io.BytesIO()
    Image.fromarray(PIXELS).convert("RGB").convert(mode).save(held, form)
    assert read_picture(file_of(tmp_path, held.getvalue())).shape == shape


@pytest.mark.parametrize("kind", [np.float32, np.int32])
def test_values_that_no_scan_holds_are_named(tmp_path, kind):
    with pytest.raises(PictureError, match=f"holds {np.dtype(kind)} values"):
        read_picture(file_of(tmp_path, encoded("TIFF", PIXELS.astype(kind))))


def test_sixteen_bits_of_colour_are_kept(tmp_path):
    colour = RNG.integers(0, 65535, (8, 9, 3)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "a.png"), colour)
    assert np.array_equal(read_picture(tmp_path / "a.png"), colour[..., ::-1])


def test_a_rotation_in_the_exif_does_not_turn_the_pixels(tmp_path):
    exif = Image.Exif()
    exif[274] = 6
    assert read_picture(file_of(tmp_path, encoded("JPEG", exif=exif))).shape == (40, 30)


def test_a_stack_is_not_one_picture(tmp_path):
    more = [Image.fromarray(PIXELS)] * 2
    with pytest.raises(PictureError, match=r"several pictures \(3 pages\)"):
        read_grey(file_of(tmp_path, encoded("TIFF", save_all=True, append_images=more)))


@pytest.mark.parametrize("compression", ["raw", "tiff_lzw", "tiff_adobe_deflate"])
def test_the_pages_of_a_stack_are_counted(compression):
    more = [Image.fromarray(PIXELS)] * 6
    assert look_into(encoded("TIFF", save_all=True, append_images=more, compression=compression)).pages == tuple(
        range(7)
    )


@pytest.mark.parametrize(
    ("description", "said"),
    [("ImageJ=1.53\nimages=40\n", "40 pictures of which 1"), ("ImageJ=1.53\nimages=4\nchannels=2\n", "2 channels")],
)
def test_a_stack_that_lacks_pages_or_mixes_channels_is_named(tmp_path, description, said):
    with pytest.raises(PictureError, match=said):
        read_picture(file_of(tmp_path, encoded("TIFF", tiffinfo={270: description})))


def test_a_thumbnail_beside_a_picture_is_no_page_of_it(tmp_path):
    small = Image.fromarray(PIXELS[:10, :8])
    small.encoderinfo = {"tiffinfo": {254: 1}}
    assert read_picture(file_of(tmp_path, encoded("TIFF", save_all=True, append_images=[small]))).shape == (40, 30)


def test_what_looks_like_a_picture_and_is_none_is_told_with_the_reason(tmp_path):
    for name in ("f10.png", "f2.PNG", "f1.jpg", "notes.txt", "Thumbs.db", "desktop.ini", ".DS_Store", "._f1.jpg"):
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "empty.png").touch()
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "gone.png").symlink_to("nowhere")
    (tmp_path / "circle.png").symlink_to("circle.png")
    os.mkfifo(tmp_path / "pipe.png")
    found = list_pictures(tmp_path)
    assert found.names == ["f1.jpg", "f2.PNG", "f10.png"]
    assert {name: why.split()[1] for name, why in found.odd.items()} == {
        "circle.png": "be", "empty.png": "empty", "folder.png": "a", "gone.png": "a", "pipe.png": "no",
    }  # fmt: skip


def test_pictures_in_folders_inside_are_pointed_to(tmp_path):
    (tmp_path / "left").mkdir()
    (tmp_path / "left" / "1.png").touch()
    with pytest.raises(ScanFileError, match="there are some in left"):
        list_pictures(tmp_path)


def test_problems_are_told_by_reason_and_cut_short():
    assert told([("a", "is empty"), ("b", "holds x"), ("c", "is empty")]) == "a, c are empty; b holds x"
    assert told([(str(k), "is empty") for k in range(20)]) == "0, 1, 2, 3, 4, 5, 6, 7 and 12 more are empty"


@pytest.mark.parametrize("cut", [10, 30, 60])
def test_a_damaged_remark_in_a_picture_is_passed_over_without_a_word(tmp_path, capfd, cut):
    exif = Image.Exif()
    exif[306], exif.get_ifd(0x8769)[36867] = "2021:03:04 12:00:01", "2021:03:04 12:00:00"
    raw = exif.tobytes()
    whole = encoded("JPEG", exif=raw[:cut] + bytes(len(raw) - cut))
    assert read_picture(file_of(tmp_path, whole)).shape == (40, 30)
    look_into(whole).taken_at()
    assert capfd.readouterr() == ("", "")
