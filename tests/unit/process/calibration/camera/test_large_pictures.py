"""Large pictures: searched coarse to fine within seconds, and as accurate as the full picture allows."""

from __future__ import annotations

import time

import cv2
import numpy as np
import pytest

from acquire.contract.errors import CalibrationError
from process.calibration.board.detection import Board, BoardNotFoundError, find_board
from process.calibration.board.pyramid import SEARCH_SIDE_PX, in_full, levels, reduced
from process.calibration.camera.calibrate import calibrate_camera

BOARD = Board(10, 7, 25.0)
SIZE = (4032, 3024)
SQUARE_PX = 240
QUIET = 960
SECONDS = 60.0
"""Time limit of one picture on a loaded machine: the full search took 19 s with a board, 139 s without."""


def large_board(
    seen: list[list[float]], board: Board = BOARD, size: tuple[int, int] = SIZE
) -> tuple[np.ndarray, np.ndarray]:
    """A board whose outline is seen at four places in px, and its inner corners [n, 2]."""
    row, column = np.indices((board.rows, board.columns))
    squares = np.kron(np.where((row + column) % 2 == 0, 25.0, 210.0), np.ones((SQUARE_PX, SQUARE_PX)))
    flat = np.pad(squares, QUIET, constant_values=210.0)
    right, below = QUIET + board.columns * SQUARE_PX - 0.5, QUIET + board.rows * SQUARE_PX - 0.5
    first = QUIET - 0.5
    outline = np.array([[first, first], [right, first], [right, below], [first, below]], np.float32)
    turn = cv2.getPerspectiveTransform(outline, np.array(seen, np.float32))
    picture = cv2.GaussianBlur(cv2.warpPerspective(flat, turn, size, borderValue=210.0), (0, 0), 2.0)
    noisy = picture + np.random.default_rng(0).normal(0, 3, picture.shape)
    x, y = np.meshgrid(np.arange(1, board.columns), np.arange(1, board.rows))
    inner = np.stack([x, y], axis=-1).reshape(-1, 1, 2) * float(SQUARE_PX) + first
    return np.clip(noisy, 0, 255).astype(np.uint8), cv2.perspectiveTransform(inner, turn).reshape(-1, 2)


def error_px(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Distance of each found corner to the nearest true one."""
    return np.linalg.norm(found[:, None] - truth[None], axis=2).min(axis=1)


@pytest.mark.parametrize(
    "seen",
    [
        [[600, 500], [3400, 700], [3300, 2500], [500, 2300]],
        [[300, 200], [3700, 900], [3000, 2700], [800, 2800]],
        [[1900, 1400], [2500, 1450], [2480, 1900], [1880, 1850]],
    ],
    ids=["tilted", "large", "small"],
)
def test_corners_of_a_large_picture_are_those_of_the_full_picture(seen):
    picture, truth = large_board(seen)
    began_s = time.monotonic()
    found = find_board(picture, BOARD)
    assert time.monotonic() - began_s < SECONDS
    assert found.whole
    assert np.sqrt((error_px(found.pixels, truth) ** 2).mean()) < 0.1
    assert error_px(found.pixels, truth).max() < 0.3


def test_part_of_a_board_in_a_large_picture_is_found():
    picture, truth = large_board([[1500, 500], [5200, 700], [5100, 2900], [1400, 2600]])
    found = find_board(picture, BOARD)
    assert len(found.pixels) >= 30
    assert error_px(found.pixels, truth).max() < 0.3


def test_a_large_picture_without_a_board_is_refused_within_seconds():
    texture = cv2.resize(np.random.default_rng(1).integers(0, 255, (76, 101), dtype=np.uint8), SIZE)
    began_s = time.monotonic()
    with pytest.raises(BoardNotFoundError):
        find_board(texture, BOARD)
    assert time.monotonic() - began_s < SECONDS


def test_a_picture_of_usual_size_is_searched_as_it_is():
    picture = np.zeros((1200, SEARCH_SIDE_PX), np.uint8)
    (level,) = levels(picture)
    assert level.grey is picture and level.factor == 1 and level.thorough


def test_a_place_in_a_reduced_picture_is_the_same_place_in_the_full_one():
    ramp = np.tile(np.arange(240, dtype=np.uint8), (10, 1))
    assert reduced(ramp, 3).shape == (3, 80)
    assert in_full(np.array([[10.0, 1.0]]), 3) == pytest.approx(np.array([[reduced(ramp, 3)[1, 10], 4.0]]))


def test_each_picture_is_told_while_boards_are_searched():
    told: list[str] = []
    empty = np.full((48, 64), 128, np.uint8)
    with pytest.raises(CalibrationError):
        calibrate_camera([("a.png", empty), ("b.png", empty)], BOARD, progress=told.append)
    assert [line.split(":")[0] for line in told] == ["picture 1 of 2, a.png", "picture 2 of 2, b.png"]
