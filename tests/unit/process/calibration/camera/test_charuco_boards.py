"""ChArUco boards of any dictionary and layout: found by trying, recorded, named where another one was given."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from acquire.contract.errors import CalibrationError
from process.calibration.board.charuco import DICTIONARIES, dictionary_named
from process.calibration.board.detection import Board, BoardNotFoundError, find_board, settled
from process.calibration.camera.calibrate import calibrate_camera
from tests.fakes.scans.drawn_boards import PINHOLE, charuco, photograph, turned

BOARD = Board(8, 6, 0.6, "charuco")
AT = np.array([0.0, 0.0, 20.0])
ARUCO = cv2.aruco


def flat_board(columns: int, rows: int, dictionary: int, *, legacy: bool = False, share: float = 0.75) -> np.ndarray:
    """A board from above, 60 px a square."""
    pattern = ARUCO.CharucoBoard((columns, rows), 1.0, share, ARUCO.getPredefinedDictionary(dictionary))
    pattern.setLegacyPattern(legacy)
    return pattern.generateImage((60 * columns + 60, 60 * rows + 60), marginSize=30)


def refused(picture: np.ndarray, board: Board) -> str:
    with pytest.raises(BoardNotFoundError) as caught:
        find_board(picture, board)
    return str(caught.value)


@pytest.mark.parametrize("name", [name for name in dir(ARUCO) if name.startswith("DICT_")])
def test_the_dictionary_is_found_by_trying(name):
    picture = flat_board(8, 6, getattr(ARUCO, name))
    assert len(find_board(picture, BOARD).pixels) == 35
    assert settled(BOARD, [picture]).dictionary == dictionary_named(name)


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize(("columns", "rows"), [(12, 10), (9, 12), (12, 9), (7, 10)])
def test_layout_and_numbering_are_found_by_trying(columns, rows, legacy):
    board = Board(max(columns, rows), min(columns, rows), 20.0, "charuco")
    picture = flat_board(columns, rows, ARUCO.DICT_5X5_250, legacy=legacy)
    found = find_board(picture, board)
    assert len(found.pixels) == (columns - 1) * (rows - 1)
    fit = cv2.findHomography(found.board_mm, found.pixels)[0]
    assert np.abs(cv2.perspectiveTransform(found.board_mm[None], fit)[0] - found.pixels).max() < 0.5
    assert settled(board, [picture]).legacy_layout == (legacy and rows % 2 == 0)


@pytest.mark.parametrize("share", [0.5, 0.6, 0.8])
def test_markers_of_another_size_give_the_same_corners(share):
    usual, other = (find_board(flat_board(8, 6, ARUCO.DICT_6X6_250, share=size), BOARD) for size in (0.75, share))
    assert len(usual.pixels) == len(other.pixels) == 35
    assert np.abs(usual.pixels - other.pixels).max() < 0.3


@pytest.mark.parametrize(
    "dictionary", [ARUCO.DICT_5X5_250, ARUCO.DICT_APRILTAG_36h11, ARUCO.DICT_ARUCO_ORIGINAL, ARUCO.DICT_7X7_50]
)
def test_a_camera_is_calibrated_with_any_board_and_the_dictionary_is_recorded(dictionary):
    tilts = ((0.0, 2.0), (18.0, 0.0), (-18.0, 3.0), (2.0, 20.0), (0.0, -19.0))
    seen = charuco(BOARD, dictionary, legacy=True)
    views = [("empty.png", np.full((240, 320), 90, np.uint8))]
    views += [
        (f"{index}.png", photograph(seen, turned(*tilt), AT, blur_px=0.6, seed=index))
        for index, tilt in enumerate(tilts)
    ]
    result = calibrate_camera(views, BOARD, "0.png")
    known = result.document()["quality"]["board"]
    assert getattr(ARUCO, known["dictionary"], dictionary) == dictionary or known["dictionary"] in (
        "DICT_5X5",
        "DICT_7X7",
    )
    assert known["legacy_layout"] is True
    assert (known["columns"], known["rows"], known["kind"]) == (8, 6, "charuco")
    assert any(f"markers of {known['dictionary']}, layout before" in line for line in result.lines())
    assert abs(result.fit.intrinsics[0] - PINHOLE.focal[0]) < max(5 * result.sd["fx"], 0.01 * PINHOLE.focal[0])


def test_another_dictionary_than_the_one_given_is_named():
    said = refused(flat_board(8, 6, ARUCO.DICT_5X5_250), Board(8, 6, 0.6, "charuco", "DICT_4X4"))
    assert "24 markers of DICT_5X5 seen (numbers 0 to 23), only 0 of 35" in said
    assert "--dictionary is DICT_4X4" in said


def test_inner_corners_given_as_squares_are_recognised():
    said = refused(flat_board(12, 9, ARUCO.DICT_5X5_250), Board(11, 8, 20.0, "charuco"))
    assert "it looks like 12 x 9 squares (squares are counted, not inner corners); --squares is 11x8" in said


def test_a_board_with_more_markers_than_the_one_given_is_said():
    said = refused(flat_board(12, 9, ARUCO.DICT_6X6_250), Board(8, 6, 20.0, "charuco"))
    assert "54 markers of DICT_6X6 seen" in said
    assert "--squares is 8x6, a board with the numbers 0 to 23 only" in said


def test_the_other_layout_than_the_one_given_is_said():
    said = refused(flat_board(8, 6, ARUCO.DICT_5X5_250), Board(8, 6, 20.0, "charuco", legacy_layout=True))
    assert "it has the other layout" in said


def test_a_picture_without_markers_says_that_none_are_seen():
    assert "No dictionary's markers are seen" in refused(np.full((300, 400), 120, np.uint8), BOARD)


@pytest.mark.parametrize("text", ["DICT_5X5_250", "dict_5x5_1000", "5x5", " 5X5_50"])
def test_dictionaries_are_named_as_in_opencv_or_in_short(text):
    assert dictionary_named(text) == "DICT_5X5"


@pytest.mark.parametrize("text", ["", "DICT_8X8", "5x5_251", "DICT_"])
def test_an_unknown_dictionary_is_refused_with_all_names(text):
    with pytest.raises(ValueError, match="DICT_APRILTAG_36h11") as caught:
        dictionary_named(text)
    assert all(name in str(caught.value) for name in DICTIONARIES)


def test_more_squares_than_a_dictionary_has_markers_for_are_refused():
    with pytest.raises(CalibrationError, match="takes 54 markers, DICT_APRILTAG_16h5 has 30"):
        find_board(np.zeros((100, 100), np.uint8), Board(12, 9, 1.0, "charuco", "DICT_APRILTAG_16h5"))
