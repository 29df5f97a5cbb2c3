"""Calibrations that fit and yet cannot be: another board than the one given, a camera that no lens makes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError
from process.calibration.board.detection import Board, Sighting

from .bundle import CameraFit

F8 = NDArray[np.float64]
MIN_SHARE = 0.6
"""Least share of the views that have to show the same smaller board before the one given is refused."""
MIN_VIEWS = 3
SHORTEST, LONGEST = 0.2, 200.0
"""Focal lengths outside of these, in picture widths, are refused: an angle of view of 136 or 0.3 degrees."""
UNKNOWN_SHARE = 0.3
"""A focal length that is known worse than this is refused, but of nearly telecentric lenses."""
TELECENTRIC = 4.0
"""Focal length in picture widths from which distance and focal length trade against each other."""
SQUARE_PIXELS = 0.05
"""Largest difference between fx and fy that is not worth a note."""


def refuse_smaller_board(sightings: Sequence[Sighting], size: tuple[int, int], board: Board) -> None:
    """Refuse a board that is given with more squares than the views show, where the rest would be in the picture.

    Raises:
        CalibrationError: most views show all of one smaller chessboard.
    """
    if board.kind != "chessboard" or any(view.whole for view in sightings):
        return
    sizes = Counter(_corners_seen(view, board) for view in sightings if _has_room(view, size, board))
    if not sizes:
        return
    (long, short), count = sizes.most_common(1)[0]
    if count >= max(MIN_VIEWS, MIN_SHARE * len(sightings)):
        raise CalibrationError(
            f"{count} of {len(sightings)} views show a whole board of {long + 1} x {short + 1} squares, not the "
            f"{board.columns} x {board.rows} given: give --squares {long + 1}x{short + 1}, or pictures of that board"
        )


def _corners_seen(view: Sighting, board: Board) -> tuple[int, int]:
    extent = np.ptp(view.board_mm, axis=0) / board.pitch_mm + 1
    return round(float(extent.max())), round(float(extent.min()))


def _has_room(view: Sighting, size: tuple[int, int], board: Board) -> bool:
    """Whether two more squares on each side of the corners found would be in the picture."""
    plane = cv2.findHomography(view.board_mm, view.pixels)[0]
    if plane is None:
        return False
    low, high = view.board_mm.min(axis=0) - 2 * board.pitch_mm, view.board_mm.max(axis=0) + 2 * board.pitch_mm
    around = np.array([[low, [low[0], high[1]], high, [high[0], low[1]]]])
    seen = cv2.perspectiveTransform(around, plane)[0]
    return bool((seen > 0).all() and (seen < np.array(size) - 1).all())


def refuse_impossible(fit: CameraFit, size: tuple[int, int]) -> None:
    """Refuse a camera that no lens makes.

    Raises:
        CalibrationError: the focal length is impossible or unknown, or the principal point is far from the picture.
    """
    advice = "wrong squares found, too few tilts, or cropped pictures; look at the views and tilt the board more"
    widths, sd = fit.intrinsics[0] / size[0], np.sqrt(np.diag(fit.covariance))
    unknown = widths < TELECENTRIC and sd[0] > UNKNOWN_SHARE * fit.intrinsics[0]
    if not SHORTEST < widths < LONGEST or unknown:
        raise CalibrationError(
            f"the focal length came out as {fit.intrinsics[0]:.0f} +- {sd[0]:.0f} px for pictures {size[0]} px wide, "
            f"which is not plausible: {advice}"
        )
    if widths < TELECENTRIC and _outside(fit.intrinsics[2:4], size) > 0.5:
        raise CalibrationError(
            f"the principal point came out at ({fit.intrinsics[2]:.0f}, {fit.intrinsics[3]:.0f}) px, far outside of "
            f"the picture: {advice}"
        )


def _outside(point: F8, size: tuple[int, int]) -> float:
    """How far a point is outside of the picture, in its widths and heights; negative inside."""
    share = point / np.array(size)
    return float(np.maximum(-share, share - 1).max())


def plausibility_notes(fit: CameraFit, size: tuple[int, int]) -> list[str]:
    """What is possible but unusual about a camera."""
    notes, (fx, fy, cx, cy) = [], fit.intrinsics[:4]
    if _outside(fit.intrinsics[2:4], size) > 0:
        notes.append(f"the principal point ({cx:.0f}, {cy:.0f}) px is outside of the picture: was it cropped?")
    if abs(fx / fy - 1) > SQUARE_PIXELS:
        notes.append(
            f"fx and fy differ by {100 * abs(fx / fy - 1):.0f} %: stretched pictures, or squares that are not square"
        )
    return notes
