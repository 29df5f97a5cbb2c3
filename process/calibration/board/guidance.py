"""Advice while board views are collected: tilt and place of each view, what is covered, what is missing.

The tilt is found without knowing the camera: from the foreshortening of the board. The side that appears larger is the
higher one, nearer to the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from .detection import Board, BoardNotFoundError, Sighting, find_board

F8 = NDArray[np.float64]
FLAT_DEG = 6.0
"""A board with less tilt may lie flat: the camera need not look straight down, and small tilts are hard to see."""
TILTED_DEG = 8.0
"""Least tilt that helps to determine the focal length."""
ENOUGH_VIEWS = 8
GRID = (3, 4)
"""Rows and columns of the coverage map."""
SIDES = ("right", "top", "left", "bottom")
ALIKE_DEG, ALIKE_SHARE = 3.0, 0.06
"""Views that differ by less in tilt and in place (share of the picture's width) add nothing."""
_ROWS = ("top", "", "bottom")
_COLUMNS = ("left", "left of the middle", "right of the middle", "right")


@dataclass(frozen=True)
class ViewFacts:
    """One picture of the board."""

    name: str
    found: bool
    reason: str = ""
    """Why the board was not found."""
    whole: bool = False
    corners: tuple[tuple[float, float], ...] = ()
    """Found corners as shares of width and height."""
    tilt_deg: float = 0.0
    higher: str = ""
    """The side of the picture where the board is higher: one of SIDES; empty for a flat one."""

    @property
    def centre(self) -> tuple[float, float]:
        """Middle of the corners, as shares of width and height."""
        x, y = np.mean(self.corners, axis=0) if self.corners else (0.5, 0.5)
        return float(x), float(y)

    def text(self) -> str:
        """For example ``right side higher by 14 degrees``."""
        if not self.found:
            return self.reason
        part = "" if self.whole else ", in part"
        if not self.higher:
            return f"flat ({self.tilt_deg:.0f} degrees){part}"
        return f"{self.higher} side higher by {self.tilt_deg:.0f} degrees{part}"


def assess_view(name: str, picture: NDArray[np.generic], board: Board) -> ViewFacts:
    """Find the board in a grey or RGB picture and describe how it lies."""
    try:
        sighting = find_board(picture, board)
    except BoardNotFoundError as error:
        return ViewFacts(name, found=False, reason=str(error))
    height, width = picture.shape[:2]
    tilt_deg, higher = tilt_of(sighting)
    shares = sighting.pixels / np.array([max(1, width - 1), max(1, height - 1)])
    corners = tuple((round(float(x), 4), round(float(y), 4)) for x, y in shares)
    return ViewFacts(name, True, "", sighting.whole, corners, tilt_deg, higher)


def tilt_of(sighting: Sighting) -> tuple[float, str]:
    """Tilt in degrees and the higher side of the picture (empty below :data:`FLAT_DEG`)."""
    found, _ = cv2.findHomography(sighting.board_mm, sighting.pixels, 0)
    if found is None:
        return 0.0, ""
    matrix: F8 = np.asarray(found, dtype=np.float64)
    middle = sighting.board_mm.mean(axis=0)
    axes, scales, _ = np.linalg.svd(_local(matrix, middle))
    tilt_deg = float(np.degrees(np.arccos(np.clip(scales[1] / scales[0], 0.0, 1.0))))
    if tilt_deg < FLAT_DEG:
        return tilt_deg, ""
    towards = axes[:, 1]  # in the picture, across the axis about which the board is tilted
    reach = 0.5 * float(np.linalg.norm(np.ptp(sighting.board_mm, axis=0))) / 2
    on_board = np.linalg.solve(_local(matrix, middle), towards)
    step = reach * on_board / np.linalg.norm(on_board)
    ahead, behind = (abs(np.linalg.det(_local(matrix, middle + sign * step))) for sign in (1.0, -1.0))
    x, y = towards if ahead > behind else -towards
    if abs(x) >= abs(y):
        return tilt_deg, "right" if x > 0 else "left"
    return tilt_deg, "bottom" if y > 0 else "top"


def _local(matrix: F8, point: F8) -> F8:
    """Pixels per mm [2, 2] of a homography at a point of the board."""
    x, y, w = matrix @ np.array([point[0], point[1], 1.0])
    found: F8 = np.array(
        [(matrix[row, :2] * w - value * matrix[2, :2]) / w**2 for row, value in enumerate((x, y))], np.float64
    )
    return found


@dataclass(frozen=True)
class Guidance:
    """What the views cover, and what is missing."""

    coverage: tuple[tuple[int, ...], ...]
    """Number of views with a corner in each cell of GRID."""
    usable: int
    advice: tuple[str, ...]
    """What to do next, the most important first; empty when there are enough views."""
    stage_view: str
    """Name of a view with the whole board lying flat, which can define the world; empty while there is none."""

    @property
    def ready(self) -> bool:
        """True if the views are enough to calibrate."""
        return not self.advice


def guide(views: Sequence[ViewFacts]) -> Guidance:
    """Coverage of the views, and advice on the next one."""
    good = [view for view in views if view.found]
    coverage = _coverage(good)
    flat = [view for view in good if not view.higher and view.whole]
    advice = []
    if not flat:
        advice.append("lay the board flat on the stage, all of it in the picture: that view makes z = 0")
    leans = {view.higher for view in good if view.tilt_deg >= TILTED_DEG}
    missing = [side for side in SIDES if side not in leans]
    if missing:
        other = "tilt it the other way" if _opposite(missing[0]) in leans else "tilt it by 10 to 20 degrees"
        advice.append(f"{other}: {missing[0]} side higher")
    empty = _empty_corners(coverage)
    if empty:
        advice.append(f"move it: {empty[0]} is empty")
    if len(good) < ENOUGH_VIEWS:
        advice.append(f"{ENOUGH_VIEWS - len(good)} more views, each at another place or tilt")
    return Guidance(coverage, len(good), tuple(advice), flat[-1].name if flat else "")


def live_advice(live: ViewFacts, views: Sequence[ViewFacts]) -> str:
    """What to do with the current picture of the camera."""
    if not live.found:
        return f"no board: {live.reason}"
    twin = next((view for view in views if view.found and _alike(view, live)), None)
    if twin is not None:
        return f"{live.text()}: as in {twin.name}; move or tilt it first"
    return f"{live.text()}: a new view, capture it"


def _alike(one: ViewFacts, other: ViewFacts) -> bool:
    near = np.hypot(*(np.array(one.centre) - np.array(other.centre))) < ALIKE_SHARE
    return bool(near and one.higher == other.higher and abs(one.tilt_deg - other.tilt_deg) < ALIKE_DEG)


def _opposite(side: str) -> str:
    return SIDES[(SIDES.index(side) + 2) % 4]


def _coverage(views: Sequence[ViewFacts]) -> tuple[tuple[int, ...], ...]:
    rows, columns = GRID
    counts = np.zeros(GRID, np.int64)
    for view in views:
        x, y = np.array(view.corners).T
        cells = np.zeros(GRID, np.bool_)
        cells[np.clip((y * rows).astype(int), 0, rows - 1), np.clip((x * columns).astype(int), 0, columns - 1)] = True
        counts += cells
    return tuple(tuple(int(count) for count in row) for row in counts)


def _empty_corners(coverage: tuple[tuple[int, ...], ...]) -> list[str]:
    """Names of the empty cells, those in the corners first: distortion is largest there."""
    rows, columns = GRID
    cells = [(row, column) for row in range(rows) for column in range(columns) if not coverage[row][column]]
    outer = (0, rows - 1), (0, columns - 1)
    cells.sort(key=lambda cell: -(int(cell[0] in outer[0]) + int(cell[1] in outer[1])))
    return [
        ("corner " if row in outer[0] and column in outer[1] else "") + f"{_ROWS[row]} {_COLUMNS[column]}".strip()
        for row, column in cells
    ]
