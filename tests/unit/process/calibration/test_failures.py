"""Inputs that cannot be calibrated with: each fails in its own words, and no file is written."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from acquire.contract.errors import CalibrationError
from process.calibration.board.detection import Board
from process.calibration.calibration_file import new_document, write_document
from tests.fakes.scans.drawn_boards import (
    PINHOLE,
    Light,
    Pinhole,
    bulge,
    charuco,
    chessboard,
    photograph,
    sweep,
    turned,
)
from tui.cli import cli

BOARD = Board(13, 10, 0.3)
AT = np.array([0.0, 0.0, 20.0])
FLAT, TILTED = turned(0, 0), turned(9, 4)


def calibrate(folder: Path, *arguments: str) -> list[Path]:
    """Run the command; returns what it wrote, besides what was there before."""
    before = set(folder.rglob("*"))
    result = CliRunner().invoke(
        cli, ["calibrate", *arguments, "--out", str(folder / "out.json")], standalone_mode=False
    )
    written = sorted(set(folder.rglob("*")) - before)
    if result.exception is not None:
        assert not written, f"a failure left {written}"
        raise result.exception
    return written


def pictures(folder: Path, *images: np.ndarray) -> str:
    """A folder of views."""
    (folder / "views").mkdir()
    for index, image in enumerate(images):
        cv2.imwrite(str(folder / "views" / f"{index}.png"), image)
    return str(folder / "views")


def view(tilt_x: float, tilt_y: float, seed: int = 1) -> np.ndarray:
    return photograph(chessboard(BOARD), turned(tilt_x, tilt_y), AT, seed=seed)


def camera_file(folder: Path, camera: Pinhole = PINHOLE) -> list[str]:
    write_document(folder / "camera.json", new_document(msgspec.structs.asdict(camera.model())))
    return ["--camera", str(folder / "camera.json"), *SQUARES, *QUICK]


QUICK = ["--method", "linear"]
AUTO = ["--method", "auto"]
SQUARES = ["--squares", "13x10", "--square-mm", "0.3"]


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    """Sweeps over the board flat and tilted with which nothing is wrong."""
    folder = tmp_path_factory.mktemp("good")
    sweep(folder / "flat", chessboard(BOARD), FLAT, AT)
    sweep(folder / "tilted", chessboard(BOARD), TILTED, AT)
    return folder


def test_two_views_are_too_few(tmp_path):
    views = pictures(tmp_path, view(0, 1), view(20, 0))
    with pytest.raises(CalibrationError, match="too few views: the board was found in 2 of 2, it takes 3"):
        calibrate(tmp_path, "camera", views, *SQUARES)


def test_a_board_that_is_in_no_picture_is_said_so(tmp_path):
    views = pictures(tmp_path, *(np.full((240, 320), level, np.uint8) for level in (90, 100, 110)))
    with pytest.raises(CalibrationError, match="found in none of 3 pictures: no chessboard found .*face up"):
        calibrate(tmp_path, "camera", views, *SQUARES)


def test_parallel_views_are_named(tmp_path):
    views = pictures(tmp_path, *(view(12, 5, seed) for seed in (1, 2, 3)))
    with pytest.raises(CalibrationError, match="all views are parallel .* tilt the board by 10 to 30 degrees"):
        calibrate(tmp_path, "camera", views, *SQUARES)


def test_a_charuco_board_that_lies_upside_down_is_recognised_by_its_mirrored_markers(tmp_path):
    board = Board(8, 6, 0.6, "charuco")
    views = pictures(tmp_path, photograph(charuco(board), turned(5, 5), AT)[:, ::-1])
    with pytest.raises(CalibrationError, match="mirrored: the board lies upside down"):
        calibrate(tmp_path, "camera", views, "--squares", "8x6", "--square-mm", "0.6", "--kind", "charuco")


def test_a_board_with_more_squares_than_given_is_another_one(tmp_path):
    views = pictures(tmp_path, view(0, 1))
    with pytest.raises(CalibrationError, match="more than the 9 x 7 given: another board"):
        calibrate(tmp_path, "camera", views, "--squares", "9x7", "--square-mm", "0.3")


def test_a_board_with_squares_of_another_size_cannot_lie_on_this_stage(good, tmp_path):
    known = camera_file(tmp_path)[:2]
    scans = [str(good / "flat"), str(good / "tilted")]
    with pytest.raises(CalibrationError, match=r"with squares of 0.25 mm .* another size \(--square-mm; 0.3 would"):
        calibrate(tmp_path, "plane", *scans, *known, "--squares", "13x10", "--square-mm", "0.25")


def test_a_board_that_is_not_in_the_sweep_is_named_with_the_sweep(good, tmp_path):
    white = sweep(tmp_path / "white", lambda at: np.full(at.shape[:-1], 0.8), FLAT, AT)
    with pytest.raises(CalibrationError, match="white: no chessboard found"):
        calibrate(tmp_path, "plane", str(good / "flat"), str(white), *camera_file(tmp_path))


def test_sweeps_over_surfaces_in_one_plane_are_refused(good, tmp_path):
    again = sweep(tmp_path / "again", chessboard(BOARD), FLAT, AT, seed=2)
    with pytest.raises(CalibrationError, match="all sweeps lie in one plane"):
        calibrate(tmp_path, "plane", str(good / "flat"), str(again), *camera_file(tmp_path))


def test_a_surface_that_is_not_flat_fails_with_the_bend(good, tmp_path):
    bent = sweep(tmp_path / "bent", chessboard(BOARD), turned(-9, 4), AT, height=bulge(0.02))
    scans = [str(good / "flat"), str(good / "tilted"), str(bent)]
    with pytest.raises(CalibrationError, match="nothing was written: bent: .*bent by .* the surface is not flat"):
        calibrate(tmp_path, "plane", *scans, *camera_file(tmp_path))


def test_a_sweep_that_ends_within_the_light_edge_is_too_short(good, tmp_path):
    short = sweep(tmp_path / "short", chessboard(BOARD), TILTED, AT, light=Light(a=(0.3, 0.0, 0.4)), frames=46)
    with pytest.raises(CalibrationError, match="short: .* still within the edge in the last frame: the sweep is too"):
        calibrate(tmp_path, "plane", str(good / "flat"), str(short), *camera_file(tmp_path))


def test_a_plane_of_light_along_the_view_rays_is_refused(tmp_path):
    along = Light(a=(20.0, 0.0, 0.1))
    scans = [
        sweep(tmp_path / name, chessboard(BOARD), pose, AT, light=along) for name, pose in (("a", FLAT), ("b", TILTED))
    ]
    with pytest.raises(CalibrationError, match="parallel to the view rays within .* degrees: .* tilt the projector"):
        calibrate(tmp_path, "plane", *map(str, scans), *camera_file(tmp_path))


def test_light_that_leaks_leaves_no_dark_level(good, tmp_path):
    leaking = sweep(tmp_path / "leaking", chessboard(BOARD), TILTED, AT, light=Light(room=1.3, lamp=130.0))
    with pytest.raises(CalibrationError, match="leaking: .* never get dark: light leaks in"):
        calibrate(tmp_path, "plane", str(good / "flat"), str(leaking), *camera_file(tmp_path))


def test_saturation_is_named(good, tmp_path):
    bright = sweep(tmp_path / "bright", chessboard(BOARD), TILTED, AT, light=Light(lamp=400.0, room=0.1))
    with pytest.raises(CalibrationError, match="bright: .* saturated: lower exposure or gain"):
        calibrate(tmp_path, "plane", str(good / "flat"), str(bright), *camera_file(tmp_path))


def test_a_sweep_of_another_size_than_the_camera_is_refused(good, tmp_path):
    other = Pinhole(size=(160, 120))
    with pytest.raises(CalibrationError, match="flat has 320 x 240 pixels, the camera was calibrated at 160 x 120"):
        calibrate(tmp_path, "plane", str(good / "flat"), str(good / "tilted"), *camera_file(tmp_path, other))


def test_good_sweeps_give_the_plane_with_the_estimate_named_and_it_can_be_made_again(good, tmp_path):
    scans = [str(good / "flat"), str(good / "tilted")]
    known = camera_file(tmp_path)[: -len(QUICK)]
    written = calibrate(tmp_path, "plane", *scans, *known)
    assert [path.name for path in written] == ["out-plane.html", "out.json"]
    plane = json.loads((tmp_path / "out.json").read_text())["light_plane"]
    assert plane["method"] == "auto"
    assert np.allclose(plane["normal"], np.array([10.0, 0.0, 16.0]) / np.hypot(10, 16), atol=2e-3)
    again = [
        "calibrate",
        "refit",
        str(tmp_path / "out.json"),
        "--method",
        "linear",
        "--out",
        str(tmp_path / "new.json"),
    ]
    assert CliRunner().invoke(cli, again, standalone_mode=False).exception is None
    other = json.loads((tmp_path / "new.json").read_text())["light_plane"]
    assert other["method"] == "linear"
    assert other["quality"]["recipe"] == plane["quality"]["recipe"]
    assert other["corner_origin_mm"] != plane["corner_origin_mm"]


def test_a_reconstruction_with_another_estimate_uses_a_plane_that_is_made_again(good, tmp_path):
    scans = [str(good / "flat"), str(good / "tilted")]
    calibrate(tmp_path, "plane", *scans, *camera_file(tmp_path), *AUTO)
    arguments = ["reconstruct", scans[0], "--calibration", str(tmp_path / "out.json"), "--method", "linear"]
    run = CliRunner().invoke(cli, [*arguments, "--out", str(tmp_path / "points")], standalone_mode=False)
    assert run.exception is None
    assert "made again with linear from its own sweeps" in run.stderr
    assert "the light plane was calibrated with the estimate" not in run.stderr
    made = json.loads((tmp_path / "points" / "calibration-linear.json").read_text())
    assert made["light_plane"]["method"] == "linear"


def test_where_the_sweeps_are_gone_a_reconstruction_with_another_estimate_warns(good, tmp_path):
    moved = tmp_path / "moved"
    shutil.copytree(good, moved)
    calibrate(tmp_path, "plane", str(moved / "flat"), str(moved / "tilted"), *camera_file(tmp_path), *AUTO)
    shutil.rmtree(moved / "tilted")
    arguments = ["reconstruct", str(moved / "flat"), "--calibration", str(tmp_path / "out.json"), "--method", "linear"]
    run = CliRunner().invoke(cli, [*arguments, "--out", str(tmp_path / "points")], standalone_mode=False)
    assert "a sweep that the light plane was made of is gone" in run.stderr
    assert "calibrated with the estimate auto, the points are made with linear" in run.stderr
    assert not (tmp_path / "points" / "calibration-linear.json").exists()
