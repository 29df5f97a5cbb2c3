"""ChArUco boards and dots, seen in part, blurred and unevenly lit: found to sub-pixel, or left out with the reason."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from process.calibration.board.detection import Board, BoardNotFoundError, find_board
from process.calibration.camera.calibrate import calibrate_camera
from tests.fakes.scans.drawn_boards import PINHOLE, charuco, dots, photograph, turned

MARKERS = Board(8, 6, 0.6, "charuco")
DOTS = Board(11, 8, 0.35, "dots")
AT = np.array([0.0, 0.0, 20.0])
DRAWN = {"charuco": (MARKERS, charuco(MARKERS)), "dots": (DOTS, dots(DOTS))}


def seen(kind: str, tilt=(12.0, -8.0), **how) -> np.ndarray:
    return photograph(DRAWN[kind][1], turned(*tilt), AT, **how)


def error_px(kind: str, picture: np.ndarray, tilt=(12.0, -8.0)) -> tuple[int, np.ndarray]:
    """How many points were found, and how far each is from where it was drawn, [n, 2]."""
    found = find_board(picture, DRAWN[kind][0])
    turn = cv2.Rodrigues(turned(*tilt))[0]
    truth = cv2.projectPoints(found.object_mm, turn, AT, PINHOLE.matrix, PINHOLE.distortion)[0].reshape(-1, 2)
    return len(truth), found.pixels - truth


@pytest.mark.parametrize("kind", ["charuco", "dots"])
@pytest.mark.parametrize(
    "how", [{}, {"blur_px": 1.6}, {"uneven": (0.35, 1.1)}, {"noise": 4.0}], ids=["plain", "blurred", "uneven", "noisy"]
)
def test_points_are_where_they_were_drawn(kind, how):
    count, error = error_px(kind, seen(kind, **how))
    assert count >= {"charuco": 20, "dots": 88}[kind]
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.15
    assert np.abs(error.mean(axis=0)).max() < 0.1


def test_a_part_of_a_charuco_board_has_the_whole_boards_origin():
    count, error = error_px("charuco", seen("charuco")[:, 130:])
    shifted = error + [130, 0]
    assert 12 <= count < 30
    assert np.abs(shifted).max() < 0.4


@pytest.mark.parametrize(
    ("kind", "words"),
    [("charuco", "ChArUco corners were found, 12 are needed: too blurred"), ("dots", "all of it has")],
)
def test_a_view_that_shows_too_little_says_so(kind, words):
    with pytest.raises(BoardNotFoundError, match=words):
        find_board(seen(kind)[:, 230:], DRAWN[kind][0])


@pytest.mark.parametrize("kind", ["charuco", "dots"])
def test_a_camera_is_calibrated_and_the_view_that_hurts_is_left_out_with_its_reason(kind):
    tilts = ((0.0, 2.0), (18.0, 0.0), (-18.0, 3.0), (2.0, 20.0), (0.0, -19.0))
    views = [(f"{number}.png", seen(kind, tilt, seed=number)) for number, tilt in enumerate(tilts)]
    x, y = np.meshgrid(np.arange(PINHOLE.size[0], dtype=np.float32), np.arange(PINHOLE.size[1], dtype=np.float32))
    bent = cv2.remap(seen(kind, (15.0, 10.0)), x + 3 * np.sin(y / 40), y, cv2.INTER_LINEAR)
    views += [("bent.png", bent), ("half.png", np.full((240, 320), 90, np.uint8))]
    result = calibrate_camera(views, DRAWN[kind][0], "0.png")
    reasons = {view.name: view.reason for view in result.views if view.reason}
    assert set(reasons) == {"bent.png", "half.png"}
    assert "miss those of the other views" in reasons["bent.png"]
    sd = result.sd
    assert abs(result.fit.intrinsics[0] - PINHOLE.focal[0]) < max(5 * sd["fx"], 0.01 * PINHOLE.focal[0])
