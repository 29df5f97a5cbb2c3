"""A board with a narrow margin on a dark or uneven desk: its outer squares look like one more row in places."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from process.calibration.board.detection import Board, BoardNotFoundError, find_board

BOARD = Board(10, 7, 25.0)
SIZE = (640, 480)
SQUARE_PX = 60


def board_on_desk(margin: float, tilt_px: tuple[int, int], desk: float, board: Board = BOARD) -> np.ndarray:
    """A tilted board with a white margin of so many squares on a dark desk, blurred and noisy."""
    edge, around = int(margin * SQUARE_PX), 4 * SQUARE_PX
    width, height = board.columns * SQUARE_PX + 2 * edge, board.rows * SQUARE_PX + 2 * edge
    flat = np.full((height + 2 * around, width + 2 * around), desk)
    flat[around : around + height, around : around + width] = 225
    row, column = np.indices((board.rows * SQUARE_PX, board.columns * SQUARE_PX)) // SQUARE_PX
    squares = np.where((row + column) % 2 == 0, 25, 225)
    flat[around + edge : around + height - edge, around + edge : around + width - edge] = squares
    a, b = tilt_px
    seen = np.array([[150 + a, 60], [560, 70 + b], [600 - b, 430 - a], [90, 400]], np.float32)
    drawn = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32) + np.float32(around)
    turn = cv2.getPerspectiveTransform(drawn, seen)
    picture = cv2.GaussianBlur(cv2.warpPerspective(flat, turn, SIZE, borderValue=desk), (0, 0), 0.9)
    noise = np.random.default_rng(0).normal(0, 1.5, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("margin", "tilt_px", "desk"),
    [(0.35, (60, 20), 20.0), (0.35, (120, 60), 20.0), (0.35, (120, 60), 60.0), (0.25, (0, 0), 20.0)],
)
def test_corners_of_the_outer_squares_are_not_taken_for_another_row(margin, tilt_px, desk):
    found = find_board(board_on_desk(margin, tilt_px, desk), BOARD)
    assert found.whole
    assert len(found.pixels) == 54


@pytest.mark.parametrize("columns, rows", [(11, 7), (10, 8), (11, 8), (12, 9)])
def test_a_board_that_is_larger_by_whole_rows_is_refused(columns, rows):
    picture = board_on_desk(0.35, (60, 20), 20.0, Board(columns, rows, 25.0))
    with pytest.raises(BoardNotFoundError, match=f"at least {columns} x {rows} squares, more than the 10 x 7 given"):
        find_board(picture, BOARD)


def test_inner_corners_given_for_squares_are_refused_with_the_number_of_squares():
    with pytest.raises(BoardNotFoundError, match="10 x 7 squares, more than the 9 x 6 given.*not inner corners"):
        find_board(board_on_desk(0.6, (0, 0), 130.0), Board(9, 6, 25.0))
