"""What is chosen and refused by the data: corner estimates on wide-angle lenses, boards and cameras that cannot be."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

import cv2
import numpy as np
import pytest

from acquire.contract.errors import CalibrationError
from process.calibration.board.detection import Board, BoardNotFoundError, LargerBoardError, Sighting
from process.calibration.camera.bundle import CameraFit, fit_camera
from process.calibration.camera.calibrate import CameraResult, calibrate_camera
from process.calibration.camera.plausible import plausibility_notes, refuse_impossible

calibrate_module = import_module("process.calibration.camera.calibrate")
BOARD = Board(10, 7, 25.0)
SIZE = (1280, 960)
WIDE = np.array([[560.0, 0, 650], [0, 560, 470], [0, 0, 1]])
BARREL = np.array([-0.24, 0.07, 0.0, 0.0, -0.008])
TILTS = ((0, 0), (25, 5), (-25, 8), (5, 28), (-4, -27), (20, 20), (-18, 19), (22, -17), (-20, -21), (10, -30))


def wide_views(noise_px: float, seed: int = 0) -> list[Sighting]:
    """Views of the whole board by a wide-angle camera, in different places of the picture."""
    generator = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(9) - 4.0, np.arange(6) - 2.5)
    mm = np.column_stack([x.ravel(), y.ravel()]) * 25.0
    views = []
    for index, (a, b) in enumerate(TILTS):
        turn = cv2.Rodrigues(cv2.Rodrigues(np.radians([a, b, 4.0]))[0] @ np.diag([1.0, -1.0, -1.0]))[0]
        shift = np.array([60.0 * (index % 3 - 1), 40.0 * (index % 2) - 20, 190.0])
        pixels = cv2.projectPoints(np.column_stack([mm, np.zeros(54)]), turn, shift, WIDE, BARREL)[0].reshape(-1, 2)
        views.append(Sighting(pixels + generator.normal(0, noise_px, pixels.shape), mm, True, 60.0))
    return views


def calibrated(monkeypatch, views, corners: str = "auto", board: Board = BOARD) -> CameraResult:
    """The calibration from views, or errors, as if they had been found in pictures."""

    def found(pixels, _board):
        view = views[int(pixels[0, 0])]
        if isinstance(view, Exception):
            raise view
        return view

    monkeypatch.setattr(calibrate_module, "find_board", found)
    pictures = [(f"{k}.png", np.broadcast_to(np.uint8(k), (SIZE[1], SIZE[0]))) for k in range(len(views))]
    return calibrate_camera(pictures, board, corners=corners)


@pytest.mark.parametrize("pull", [0.0, 0.1, 0.3])
def test_auto_is_never_worse_than_the_best_single_estimate(monkeypatch, pull):
    # saddles that a simple distortion model fits better than the true corners do
    true = wide_views(0.0)
    simple = fit_camera(true, SIZE, "k1")
    views = []
    for index, (one, other) in enumerate(zip(wide_views(0.3, 1), wide_views(0.2, 2), strict=True)):
        saddle = one.pixels + pull * simple.residuals(index, true[index])
        views.append(replace(one, pixels=saddle, others={"sector": other.pixels}))
    rms = {name: calibrated(monkeypatch, views, name).fit.rms_px for name in ("auto", "saddle", "sector")}
    assert rms["auto"] <= min(rms.values()) * 1.0001


def test_views_without_the_estimate_asked_for_are_named(monkeypatch):
    views = wide_views(0.1)
    views = [replace(view, others={"sector": view.pixels} if index > 2 else {}) for index, view in enumerate(views)]
    result = calibrated(monkeypatch, views, "sector")
    assert result.corner_estimate == "sector"
    assert [view.corners for view in result.views] == ["saddle"] * 3 + ["sector"] * 7
    assert any("saddle estimate in 3 views" in note and "0.png, 1.png, 2.png" in note for note in result.notes)
    assert [view["corners"] for view in result.document()["quality"]["views"]][:4] == ["saddle"] * 3 + ["sector"]


def test_an_estimate_that_no_view_has_is_not_reported(monkeypatch):
    dots = [replace(view, estimate="centre") for view in wide_views(0.1)]
    assert calibrated(monkeypatch, dots, "auto").corner_estimate == "centre"
    result = calibrated(monkeypatch, dots, "sector")
    assert result.corner_estimate == "centre"
    assert any("centre estimate in 10 views" in note for note in result.notes)


@pytest.mark.parametrize("given", [Board(12, 9, 25.0), Board(11, 7, 25.0), Board(10, 8, 25.0)])
def test_a_board_given_too_large_is_refused_with_the_one_that_is_seen(monkeypatch, given):
    views = [replace(view, whole=False) for view in wide_views(0.1)]
    small = [replace(view, pixels=view.pixels * 0.5 + 300) for view in views]
    with pytest.raises(CalibrationError, match=f"10 x 7 squares, not the {given.columns} x {given.rows} given"):
        calibrated(monkeypatch, small, board=given)


def test_a_board_that_leaves_the_picture_is_not_taken_for_a_smaller_one(monkeypatch):
    views = [replace(view, whole=False, pixels=view.pixels * 1.6 - [380, 290]) for view in wide_views(0.05)]
    assert len(calibrated(monkeypatch, views, board=Board(12, 9, 25.0)).used) > 2


def test_a_larger_board_in_most_pictures_is_refused_instead_of_fitting_the_rest(monkeypatch):
    parts = [replace(view, whole=False) for view in wide_views(0.1)[:4]]
    larger = [LargerBoardError("the board shows at least 10 x 7 squares, more than the 9 x 6 given")] * 6
    with pytest.raises(CalibrationError, match="in 6 of 10 pictures the board shows at least 10 x 7"):
        calibrated(monkeypatch, [*parts, *larger])
    other = [BoardNotFoundError("no chessboard found")] * 6
    assert len(calibrated(monkeypatch, [*wide_views(0.1)[:4], *other]).used) == 4


def camera(fx: float, fy: float, cx: float, cy: float, sd: float = 1.0) -> CameraFit:
    return CameraFit(np.array([fx, fy, cx, cy, 0, 0, 0, 0, 0]), (), np.diag([sd * sd] * 9), 0.1, (), "none")


@pytest.mark.parametrize(
    ("fit", "said"),
    [
        (camera(90, 90, 640, 480), "focal length"),
        (camera(5e5, 5e5, 640, 480), "focal length"),
        (camera(1000, 1000, 640, 480, sd=400), "focal length"),
        (camera(1000, 1000, 2000, 480), "principal point"),
        (camera(1000, 1000, 640, -500), "principal point"),
    ],
)
def test_a_camera_that_no_lens_makes_is_refused(fit, said):
    with pytest.raises(CalibrationError, match=said):
        refuse_impossible(fit, SIZE)


def test_usual_and_telecentric_cameras_pass():
    refuse_impossible(camera(1000, 1000, 640, 480), SIZE)
    refuse_impossible(camera(15000, 15000, 2500, 480, sd=6000), SIZE)
    assert plausibility_notes(camera(1000, 1010, 640, 480), SIZE) == []


def test_unusual_cameras_have_a_note():
    assert "outside of the picture" in plausibility_notes(camera(1000, 1000, 1300, 480), SIZE)[0]
    assert "10 %" in plausibility_notes(camera(1100, 1000, 640, 480), SIZE)[0]
