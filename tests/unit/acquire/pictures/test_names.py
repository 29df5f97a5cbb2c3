"""Series of picture names: what belongs together, which number counts, and where one is missing."""

from __future__ import annotations

import os

import pytest

from acquire.pictures.names import choosing, matching, readable, series_of
from acquire.pictures.numbering import Numbering, number_of


def numbered(*names: str) -> Numbering:
    (series,) = series_of(names)
    assert not series.contradiction
    return number_of(series.members)


def patterns(*names: str) -> list[str]:
    return [series.pattern for series in series_of(names)]


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ([f"frame_{k:04d}.png" for k in range(20)], "numbers 0 to 19"),
        (["f8.png", "f9.png", "f10.png", "f11.png"], "numbers 8 to 11"),
        (["f099.png", "f100.png", "f101.png"], "numbers 99 to 101"),
        ([f"{k}.tif" for k in range(500, 510)], "numbers 500 to 509"),
        ([f"f{k:04d}.png" for k in range(0, 100, 10)], "numbers 0 to 90 in steps of 10"),
        ([f"z_{k}.png" for k in range(-3, 4)], "numbers -3 to 3"),
        (["scan-1.png", "scan-2.png", "scan-3.png"], "numbers 1 to 3"),
        ([f"2021-03-04_scan2_{k:04d}.png" for k in range(5)], "numbers 0 to 4"),
        ([f"Basler_2123_20170927_1114{k:02d}250_{k:04d}.bmp" for k in range(5)], "numbers 0 to 4"),
        (["f1.tif", "f2.TIFF", "f3.tiff"], "numbers 1 to 3"),
        (["f1.png", "f2.PNG", "F3.png"], "numbers 1 to 3"),
        (["f\u0661.png", "f\u0662.png", "f\u0663.png"], "numbers 1 to 3"),
        (["u\u0308b1.png", "\u00fcb2.png"], "numbers 1 to 2"),
        (["a b\n1.png", "a b\n2.png"], "numbers 1 to 2"),
        (["part1_001.png", "part1_002.png", "part2_003.png"], "numbers 1 to 3"),
        (["a1_b7.png", "a2_b9.png"], "numbers 1 to 2"),
        (["t0010_f1.png", "t0020_f2.png", "t0030_f3.png"], "numbers 1 to 3"),
        (["f01_t0010.png", "f02_t0020.png", "f03_t0030.png"], "numbers 1 to 3"),
    ],
)
def test_numbers_without_gaps_are_a_sequence(names, said):
    found = numbered(*names)
    assert (found.words(), found.gaps, found.faults) == (said, (), ())
    assert found.indices == tuple(range(len(names)))


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ([f"im_{k:04d}.png" for k in range(40) if k != 17], ["im_0017 is missing between im_0016 and im_0018"]),
        (["f9.png", "f11.png", "f12.png"], ["f10 is missing between f9 and f11"]),
        (["f1.png", "f2.png", "f4.png"], ["f3 is missing between f2 and f4"]),
        (["1.png", "2.png", "4.png", "6.png"], ["3 is missing between 2 and 4", "5 is missing between 4 and 6"]),
        ([f"f{k}.png" for k in (8, 9, 1010, 1011)], ["f10 to f1009 (1000 pictures) are missing between f9 and f1010"]),
        ([f"f{k:03d}.png" for k in (0, 10, 20, 40, 50)], ["f030 is missing between f020 and f040"]),
        (["z_-2.png", "z_0.png", "z_1.png", "z_2.png"], ["z_-1 is missing between z_-2 and z_0"]),
        (["a1.png", "a5.png"], ["a2 to a4 (3 pictures) are missing between a1 and a5"]),
    ],
)  # fmt: skip
def test_a_gap_is_named_with_its_neighbours(names, said):
    assert [gap.words() for gap in numbered(*names).gaps] == said


def test_frames_behind_a_gap_keep_their_index():
    assert numbered("f5.png", "f6.png", "f9.png").indices == (0, 1, 4)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["f1.png", "f01.png", "f2.png"], "number 01 is there 2 times"),
        (["IMG_1.JPG", "img_1.jpg", "IMG_2.JPG"], "number 1 is there 2 times"),
        (["f1.tif", "f1.tiff", "f2.tif"], "number 1 is there 2 times"),
        ([f"{1614859200123 + 33 * k + k % 3}.png" for k in range(9)], "do not count in equal steps"),
        (["f1.png", "f9999999999999.png"], "do not count frames"),
    ],
)
def test_numbers_that_do_not_count_frames_are_told(names, said):
    assert said in " ".join(numbered(*names).faults)


def test_series_are_told_apart():
    left, right = [f"left_{k:04d}.png" for k in range(3)], [f"right_{k:04d}.png" for k in range(4)]
    assert patterns(*left, *right) == ["right_####.png", "left_####.png"]
    assert patterns(*left, "background.png", "dark.tif") == ["left_####.png", "background.png", "dark.tif"]
    assert patterns("a1.png", "a1.jpg", "a2.png", "a2.jpg") == ["a#.jpg", "a#.png"]
    assert patterns("cam1_5.png", "cam1_6.png", "cam2_5.png", "cam2_6.png") == ["cam1_#.png", "cam2_#.png"]
    assert patterns("f1.png", "f2.png", "f1 (1).png") == ["f#.png", "f1 (1).png"]
    assert len(series_of([f"12-{m}-{s:02d}.png" for m in (30, 31) for s in range(0, 60, 20)])) == 2


def test_two_numbers_that_disagree_about_the_order_are_told():
    (series,) = series_of([f"cam{1 + k % 2}_{k:04d}.png" for k in range(5)])
    assert "disagree" in series.contradiction and "cam2_0001.png" in series.contradiction


@pytest.mark.parametrize(
    "names",
    [
        ["left_0001.png", "left_0002.png", "left_0001_mask.png", "right_0001.png", "right_0002.png"],
        ["s[1]_1.png", "s[1]_2.png", "s1_1.png", "s1_2.png", "b*.png"],
        ["a1.png", "a2.png", "a1.tif", "a2.TIF"],
        ["z_-1.png", "z_0.png", "z_1.png", "dark.png"],
    ],
)
def test_the_pattern_proposed_for_a_series_chooses_it_and_nothing_else(names):
    for series in series_of(names):
        assert set(matching(names, choosing(series, names))) == set(series.names)


def test_names_are_shown_readable_whatever_their_bytes():
    assert readable(os.fsdecode(b"view\xff\n\x1b[1m.png")) == r"view\xff\n\x1b[1m.png"
    assert readable("\u00fcber.png") == "\u00fcber.png"
