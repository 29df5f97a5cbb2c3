"""Folders as strangers bring them, from import to reconstruct: status, one sentence, no false success."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from tui import cli

FRAMES, HEIGHT, WIDTH = 40, 24, 64


def sweep(index: int) -> NDArray[np.float64]:
    """The pixel of column x crosses half brightness at frame x / 2 + 4."""
    lit = 1 / (1 + np.exp(-((index - 4) - np.arange(WIDTH) / 2.0)))
    return np.tile(10 + 190 * lit, (HEIGHT, 1))


def eight(pixels: NDArray[np.float64]) -> NDArray[np.uint8]:
    return pixels.astype(np.uint8)


def frames(folder: Path, *, suffix: str = "png", make: Callable[[int], NDArray[np.generic]] | None = None) -> Path:
    folder.mkdir()
    for index in range(FRAMES):
        pixels = eight(sweep(index)) if make is None else make(index)
        assert cv2.imwrite(str(folder / f"frame_{index:04d}.{suffix}"), pixels)
    return folder


def crossings(scan: Path) -> NDArray[np.float64]:
    with h5py.File(scan.parent / "maps.h5") as file:
        return file["crossing"][HEIGHT // 2]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    def run(*arguments: object) -> tuple[int, str, str]:
        status = cli.run([str(argument) for argument in arguments])
        said = capsys.readouterr()
        assert "a bug" not in said.err
        return status, said.out, said.err

    return run


def test_a_folder_with_a_gap_is_refused_and_nothing_is_written(tmp_path, run):
    (frames(tmp_path / "frames") / "frame_0017.png").unlink()
    status, _, said = run("import", tmp_path / "frames", tmp_path / "scan.h5")
    assert status == 1 and said.count("\n") == 1
    assert "frame_0017 is missing between frame_0016 and frame_0018" in said
    assert "--missing-as-missing" in said and "--as-is" in said
    assert [path.name for path in tmp_path.iterdir()] == ["frames"]


def test_positions_behind_a_kept_gap_stay_right(tmp_path, run):
    whole, lacking = tmp_path / "whole", tmp_path / "lacking"
    whole.mkdir()
    lacking.mkdir()
    run("import", frames(tmp_path / "frames"), whole / "scan.h5")
    (tmp_path / "frames" / "frame_0017.png").unlink()
    status, said, _ = run("import", tmp_path / "frames", lacking / "scan.h5", "--missing-as-missing")
    assert status == 4 and "NOT COMPLETE, 39 of 40" in said and "frame_0017 is missing" in said
    assert run("reconstruct", whole / "scan.h5")[0] == 0
    status, said, _ = run("reconstruct", lacking / "scan.h5")
    assert status == 4 and "SAVED" not in said
    status, said, _ = run("verify", lacking / "scan.h5")
    assert status == 4 and "SAVED" not in said and "frame_0017" in said
    before, after = crossings(whole / "scan.h5"), crossings(lacking / "scan.h5")
    columns = slice(4, 56)
    assert np.nanmax(np.abs(after[columns] - before[columns])) < 0.3


@pytest.mark.parametrize("kind", ["two", "extra", "dup"])
def test_several_series_in_one_folder_are_refused_by_name(tmp_path, run, kind):
    folder = frames(tmp_path / "frames")
    if kind == "extra":
        for name in ("background.png", "thumbnail.jpg"):
            cv2.imwrite(str(folder / name), eight(sweep(0)))
    for index in range(FRAMES if kind != "extra" else 0):
        name = f"right_{index:04d}.png" if kind == "two" else f"frame_{index:04d}.jpg"
        cv2.imwrite(str(folder / name), eight(sweep(FRAMES - index)))
    status, _, said = run("import", folder, tmp_path / "scan.h5")
    expected = {"two": "right_####.png", "extra": "background.png, thumbnail.jpg", "dup": "frame_####.jpg"}
    assert status == 1 and expected[kind] in said and "--pattern" in said
    assert run("import", folder, tmp_path / "scan.h5", "--pattern", "frame_*.png")[0] == 0


@pytest.mark.parametrize("scale", [4095 / 255, 16 * 4095 / 255, 257, 256, 1023 / 255])
def test_depth_is_found_in_the_values_and_the_crossings_are_the_same(tmp_path, run, scale):
    plain, deep = tmp_path / "plain", tmp_path / "deep"
    plain.mkdir()
    deep.mkdir()

    def stretched(index: int) -> NDArray[np.uint16]:
        unit = 16 if scale == 16 * 4095 / 255 else 1
        return (np.round(sweep(index) * scale / unit) * unit).astype(np.uint16)

    run("import", frames(tmp_path / "frames"), plain / "scan.h5")
    status, said, _ = run("import", frames(tmp_path / "deeper", suffix="tif", make=stretched), deep / "scan.h5")
    assert status == 0 and ("--bit-depth" in said or scale > 255)
    assert run("reconstruct", plain / "scan.h5", "--method", "linear")[0] == 0
    assert run("reconstruct", deep / "scan.h5", "--method", "linear")[0] == 0
    one, other = crossings(plain / "scan.h5"), crossings(deep / "scan.h5")
    assert np.isfinite(other).sum() >= np.isfinite(one).sum() > 50
    assert np.nanmax(np.abs(one - other)) < 0.05


def test_a_depth_that_is_given_wins(tmp_path, run):
    folder = frames(tmp_path / "frames", suffix="tif", make=lambda index: (16 * sweep(index)).astype(np.uint16))
    status, said, _ = run("import", folder, tmp_path / "scan.h5", "--bit-depth", "16", "--json")
    assert status == 0 and json.loads(said)["format"]["bit_depth"] == 16
    status, _, said = run("reconstruct", tmp_path / "scan.h5")
    assert status == 1 and "no pixel changes by 70 counts" in said and "--bit-depth" in said


def test_a_falling_edge_is_tried_where_the_default_finds_nothing(tmp_path, run):
    folder = frames(tmp_path / "frames", make=lambda index: eight(210 - sweep(index)))
    run("import", folder, tmp_path / "scan.h5")
    status, said, notes = run("reconstruct", tmp_path / "scan.h5")
    assert status == 0 and "1536 crossings" in said and "taken for a falling one" in notes
    assert "earlier" not in notes
    status, _, said = run("reconstruct", tmp_path / "scan.h5", "--edge", "rising")
    assert status == 1 and "--edge falling" in said and "earlier" not in said


def test_a_result_without_a_crossing_is_status_1_also_as_json(tmp_path, run):
    run("import", frames(tmp_path / "frames"), tmp_path / "scan.h5")
    status, out, said = run("reconstruct", tmp_path / "scan.h5", "--contrast", 250, "--json")
    assert status == 1 and said.startswith("sweepscope: no pixel has a crossing") and "--contrast" in said
    assert json.loads(out)["complete"] is True


def test_info_lists_the_files_of_an_import_for_sha256sum(tmp_path, run):
    run("import", frames(tmp_path / "frames"), tmp_path / "scan.h5")
    status, said, _ = run("info", tmp_path / "scan.h5", "--sources")
    assert status == 0 and said.splitlines()[3].endswith("  frame_0003.png") and len(said.splitlines()) == FRAMES
    status, said, _ = run("info", tmp_path / "scan.h5")
    assert "frame_0000.png to frame_0039.png" in said and "numbers 0 to 39" in said
    status, said, _ = run("info", tmp_path / "scan.h5", "--json")
    assert json.loads(said)["sources"]["files"][39]["name"] == "frame_0039.png"


def test_options_that_contradict_are_wrong_usage(tmp_path, run):
    folder = frames(tmp_path / "frames")
    assert run("import", folder, tmp_path / "scan.h5", "--as-is", "--missing-as-missing")[0] == 2
    assert run("import", folder, tmp_path / "scan.h5", "--bit-depth", 7)[0] == 2
