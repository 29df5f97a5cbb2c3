"""The camera's calibration: on the public board views, on drawn boards, and on pictures that cannot do."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from acquire.contract.errors import CalibrationError
from process.calibration.board.detection import Board, BoardNotFoundError, find_board
from process.calibration.camera.bundle import CameraFit
from process.calibration.camera.calibrate import calibrate_camera
from process.calibration.camera.selection import choose_corners, choose_model, without_k1
from tests.accuracy.uncertainty import SMALL, see

BOARD = Board(13, 10, 0.3)
SIZE = (480, 360)
MATRIX = np.array([[5400.0, 0.0, 250.0], [0.0, 5390.0, 170.0], [0.0, 0.0, 1.0]])
DISTORTION = np.array([-0.3, 0.0, 0.0, 0.0, 0.0])
TILTS = ((0.0, 1.2), (20.0, 0.0), (-20.0, 3.0), (2.0, 22.0), (0.0, -21.0), (15.0, 15.0), (-16.0, 14.0))
FINE = 3


def pose(tilt_deg: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    tilt = cv2.Rodrigues(np.radians([tilt_deg[0], tilt_deg[1], 3.0]))[0]
    return tilt @ np.diag([1.0, -1.0, -1.0]), np.array([-0.13, 0.14, 76.0])


def picture(tilt_deg: tuple[float, float], seed: int = 1, board: Board = BOARD) -> np.ndarray:
    """A board as a pinhole camera with distortion sees it: drawn fine, made coarse, blurred, noisy, unevenly lit."""
    width, height = SIZE
    x, y = np.meshgrid((np.arange(width * FINE) + 0.5) / FINE - 0.5, (np.arange(height * FINE) + 0.5) / FINE - 0.5)
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2), MATRIX, DISTORTION).reshape(-1, 2)
    rotation, shift = pose(tilt_deg)
    directions = np.column_stack([rays, np.ones(len(rays))]) @ rotation
    centre = -rotation.T @ shift
    at = (centre - (centre[2] / directions[:, 2])[:, None] * directions)[:, :2] / board.pitch_mm
    cells = np.floor(at + [board.columns / 2, board.rows / 2])
    inside = ((cells >= 0) & (cells < [board.columns, board.rows])).all(axis=1)
    dark = inside & (cells.sum(axis=1) % 2 == 0)
    fine = np.where(dark, 25.0, 190.0).reshape(height * FINE, width * FINE)
    coarse = cv2.GaussianBlur(cv2.resize(fine, SIZE, interpolation=cv2.INTER_AREA), (0, 0), 0.9)
    lit = coarse * np.linspace(0.6, 1.1, width)
    noise = np.random.default_rng(seed).normal(0, 1.5, lit.shape)
    return np.clip(lit + noise, 0, 255).round().astype(np.uint8)


@pytest.fixture(scope="module")
def views() -> list[tuple[str, np.ndarray]]:
    return [(f"{index}.png", picture(tilt, index)) for index, tilt in enumerate(TILTS)]


def test_corners_of_a_drawn_board_are_found_to_sub_pixel_and_without_bias(views):
    found = find_board(views[1][1], BOARD)
    rotation, shift = pose(TILTS[1])
    truth = cv2.projectPoints(found.object_mm, cv2.Rodrigues(rotation)[0], shift, MATRIX, DISTORTION)[0]
    error = found.pixels - truth.reshape(-1, 2)
    assert found.whole
    assert np.abs(error).max() < 0.15
    assert np.abs(error.mean(axis=0)).max() < 0.02


def test_part_of_a_board_is_found_where_the_rest_is_outside_of_the_picture(views):
    found = find_board(views[0][1][:, 200:], BOARD)
    assert not found.whole
    assert len(found.pixels) > 60


def test_the_camera_is_what_the_pictures_were_drawn_with_within_three_standard_deviations(views):
    result = calibrate_camera(views, BOARD, "0.png")
    truth = [5400.0, 5390.0, 250.0, 170.0]
    sd = [result.sd[name] for name in ("fx", "fy", "cx", "cy")]
    assert (np.abs(result.fit.intrinsics[:4] - truth) < 3 * np.array(sd) + 1e-9).all()
    assert result.fit.rms_px < 0.05
    assert result.stage is not None
    rotation, shift = pose(TILTS[0])
    corner = np.array([1.5, 1.2, 0.0])
    seen = cv2.projectPoints(corner, cv2.Rodrigues(rotation)[0], shift, MATRIX, DISTORTION)[0]
    own = cv2.projectPoints(
        corner, result.stage.rotation_vector, result.stage.translation, result.fit.matrix, result.fit.distortion
    )[0]
    assert np.abs(seen - own).max() < 0.05


def test_z_of_the_world_points_at_the_camera(views):
    result = calibrate_camera(views[:4], BOARD, "0.png")
    assert result.stage is not None
    assert (-result.stage.rotation.T @ result.stage.translation)[2] > 70


def test_the_public_views_give_one_radial_term_and_an_eighth_of_a_pixel(real_scan):
    pictures = [(path.name, cv2.imread(str(path), 0)) for path in sorted((real_scan / "checkerboard").glob("*.jpg"))]
    result = calibrate_camera(pictures, Board(9, 7, 30.0))
    assert len(result.used) == 10
    assert result.fit.rms_px <= 0.125
    assert result.fit.model == "k1"


def test_a_small_board_that_hardly_shows_the_lens_still_takes_its_term_and_says_how_uncertain_it_is():
    generator = np.random.default_rng(5)
    views = [see(SMALL, tilt, generator) for tilt in SMALL.views[:9]]
    fit, held_out_px = choose_model(views, SMALL.size)
    assert held_out_px["none"] < 1.003 * held_out_px["k1"], "held-out views alone would leave it out"
    assert fit.model == "k1"
    assert abs(fit.intrinsics[4] + 0.3) < 3 * np.sqrt(fit.covariance[4, 4])


def test_a_term_that_is_left_out_stays_uncertain_by_what_it_may_be():
    covariance = np.diag([4.0, 4.0, 1.0, 1.0, 0.01, 0, 0, 0, 0])
    covariance[0, 4] = covariance[4, 0] = 0.1
    fit = CameraFit(np.array([100.0, 100.0, 50.0, 50.0, 0.2, 0, 0, 0, 0]), (), covariance, 0.1, (), "k1")
    left_out = without_k1(fit)
    assert left_out[4, 4] == pytest.approx(0.01 + 0.2**2)
    assert left_out[0, 0] == pytest.approx(4.0 + (10 * 0.2) ** 2)


def test_two_views_are_too_few(views):
    with pytest.raises(CalibrationError, match="too few views"):
        calibrate_camera(views[:2], BOARD)


def test_pictures_without_a_board_are_refused_with_the_reason():
    empty = np.full((360, 480), 128, np.uint8)
    with pytest.raises(CalibrationError, match="found in none of 3 pictures: no chessboard"):
        calibrate_camera([(str(k), empty) for k in range(3)], BOARD)


def test_parallel_views_cannot_tell_the_focal_length():
    same = [(str(k), picture((12.0, 5.0), k)) for k in range(3)]
    with pytest.raises(CalibrationError, match="parallel"):
        calibrate_camera(same, BOARD)


def test_a_board_with_more_squares_than_given_is_named(views):
    with pytest.raises(BoardNotFoundError, match="more than the 9 x 7 given"):
        find_board(views[0][1], Board(9, 7, 0.3))


def test_a_view_of_another_board_is_left_out_with_its_reason(views):
    bent = picture(TILTS[1], 9)
    rows = np.arange(SIZE[1], dtype=np.float32)
    x, y = np.meshgrid(np.arange(SIZE[0], dtype=np.float32), rows)
    bent = cv2.remap(bent, x + 2.5 * np.sin(y / 40), y, cv2.INTER_LINEAR)
    result = calibrate_camera([*views, ("bent.png", bent)], BOARD)
    assert [view.name for view in result.views if view.reason] == ["bent.png"]


def test_the_stage_view_must_be_among_the_pictures(views):
    with pytest.raises(CalibrationError, match="not among the pictures"):
        calibrate_camera(views, BOARD, "flat.png")


def test_comparable_estimates_of_the_corners_are_averaged_and_a_worse_one_is_not(views):
    sightings = [find_board(pixels, BOARD) for _, pixels in views]
    truth = [
        cv2.projectPoints(seen.object_mm, cv2.Rodrigues(turn)[0], shift, MATRIX, DISTORTION)[0].reshape(-1, 2)
        for seen, (turn, shift) in zip(sightings, [pose(tilt) for tilt in TILTS], strict=True)
    ]
    source = np.random.default_rng(3)

    def noisy(sd_px: float) -> list[np.ndarray]:
        return [at + source.normal(0, sd_px, at.shape) for at in truth]

    def chosen(second_px: float) -> tuple[str, float]:
        seen = [
            replace(sighting, pixels=one, others={"gradient": two})
            for sighting, one, two in zip(sightings, noisy(0.1), noisy(second_px), strict=True)
        ]
        taken, name = choose_corners(seen, SIZE)
        error = np.concatenate([view.pixels - at for view, at in zip(taken, truth, strict=True)])
        return name, float(np.sqrt((error**2).mean()))

    name, error_px = chosen(0.11)
    assert name == "saddle + gradient" and error_px < 0.08
    assert chosen(0.2)[0] == "saddle"
