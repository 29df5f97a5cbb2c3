"""Board views that cannot be used are left out by name; the others are read."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from acquire.contract.errors import CalibrationError
from tui.commands.calibrate.camera import SlowProgress, read_pictures
from tui.commands.calibrate.response import _from_folder

RNG = np.random.default_rng(1)


def view(path: Path, shape: tuple[int, ...] = (20, 30)) -> None:
    assert cv2.imwrite(str(path), RNG.integers(0, 255, shape).astype(np.uint8))


def test_views_that_cannot_be_used_are_all_left_out_by_name(tmp_path):
    for k in range(6):
        view(tmp_path / f"view{k}.png", (20, 31) if k in (1, 4) else (20, 30))
    view(tmp_path / "long.png")
    (tmp_path / "long.png").rename(tmp_path / os.fsdecode(b"view\xff.png"))
    (tmp_path / "view7.png").write_bytes(b"no picture")
    (tmp_path / "view8.png").touch()
    (tmp_path / "._view1.png").write_bytes(b"of a Mac")
    found = read_pictures((tmp_path,))
    assert [name for name, _ in found.pictures] == ["view0.png", "view2.png", "view3.png", "view5.png", r"view\xff.png"]
    assert {name: why[:8] for name, why in found.left_out} == {
        "view8.png": "is empty", "view7.png": "is no re", "view1.png": "is 31 x ", "view4.png": "is 31 x ",
    }  # fmt: skip


def test_colour_and_grey_views_of_one_size_are_used_together(tmp_path):
    view(tmp_path / "1.png")
    view(tmp_path / "2.png", (20, 30, 3))
    assert [pixels.shape for _, pixels in read_pictures((tmp_path,)).pictures] == [(20, 30)] * 2


def test_no_view_at_all_is_refused_with_each_reason(tmp_path):
    (tmp_path / "1.png").write_bytes(b"no")
    (tmp_path / "2.png").touch()
    with pytest.raises(CalibrationError, match=r"2\.png is empty; 1\.png is no readable picture"):
        read_pictures((tmp_path,))


def test_exposures_that_cannot_be_used_are_left_out_by_name(tmp_path, capsys):
    view(tmp_path / "white.png")
    (tmp_path / "white-20ms.png").write_bytes(b"no")
    with pytest.raises(CalibrationError, match=r"white\.png has no exposure") as error:
        _from_folder(tmp_path)
    assert "white-20ms.png is no readable picture" in str(error.value)
    view(tmp_path / "white-10ms.png")
    assert [exposure_ms for exposure_ms, _ in _from_folder(tmp_path)[0]] == [10.0]
    said = capsys.readouterr().err
    assert "left out: white.png has no exposure" in said and "left out: white-20ms.png is no readable" in said


def test_exposures_of_twelve_bits_in_sixteen_have_twelve(tmp_path):
    for ms in (5, 10, 20, 40):
        cv2.imwrite(str(tmp_path / f"{ms}ms.tif"), RNG.integers(0, 4095, (50, 60)).astype(np.uint16))
    series, depth = _from_folder(tmp_path)
    assert depth == 12 and len(series) == 4


def test_progress_is_silent_for_quick_work_and_told_whole_once_it_takes_longer(capsys):
    clock = iter([0.0, 1.0, 3.0, 4.0])
    progress = SlowProgress(now=lambda: next(clock))
    progress("picture 1 of 3")
    assert capsys.readouterr().err == ""
    progress("picture 2 of 3")
    assert capsys.readouterr().err == "picture 1 of 3\npicture 2 of 3\n"
    progress("picture 3 of 3")
    assert capsys.readouterr().err == "picture 3 of 3\n"
