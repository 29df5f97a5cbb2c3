"""Detection of a calibration board in a picture: chessboard, ChArUco or dots, whole or in part, to sub-pixel.

Pixels [n, 2] as x, y with centres at integers. Board coordinates [n, 2] in mm about the middle of the pattern, turned
so that the board's z points at the camera. Accuracy of the corners: docs/accuracy.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import islice
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError

from .charuco import find_corners, possible_layouts, refusal
from .grid_growth import best_block, grow
from .pyramid import Level, in_full, levels, refined_in_full
from .saddles import refine_saddles, saddle_blocks

F8 = NDArray[np.float64]
MIN_CORNERS = 12
"""Least corners of a view: fewer say too little of a pose."""
SEED_SIDES = (7, 4, 3)
"""Sides of the small grids that are searched where the whole pattern is not in the picture."""
SEED_ATTEMPTS = 8
MIN_ROW = 3
"""Least corners of a border row of the grid: one or two may be false."""
SADDLE_SHARE = 0.5
"""Least share of saddles in a border row that makes the grid larger than the board given."""
CHARUCO_WINDOW_SHARE = 0.4
"""Share of the window for a chessboard's corner: the markers begin an eighth of a square away."""
MOST_SETTLING = 6
"""Most pictures in which the dictionary of a board is searched."""
SMALL_GRID = 200
"""Corners up to which OpenCV's exhaustive search is quick enough; larger grids are grown."""
_SECTOR = cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE


class BoardNotFoundError(CalibrationError):
    """No usable pattern in a picture; the text says why."""


class LargerBoardError(BoardNotFoundError):
    """The board in a picture has more squares than the one given."""


@dataclass(frozen=True)
class Board:
    """A calibration board."""

    columns: int
    """Squares (chessboard, ChArUco) or dots along the longer side."""
    rows: int
    pitch_mm: float
    """Side of a square, or distance of two dots, in mm."""
    kind: Literal["chessboard", "charuco", "dots"] = "chessboard"
    dictionary: str = ""
    """ChArUco: dictionary of the markers (``charuco.DICTIONARIES``); empty: found by trying."""
    legacy_layout: bool | None = None
    """ChArUco: True for the layout before OpenCV 4.6; None: found by trying."""

    @property
    def grid(self) -> tuple[int, int]:
        """Columns and rows of the points that are found: inner corners, or dots."""
        return (self.columns, self.rows) if self.kind == "dots" else (self.columns - 1, self.rows - 1)

    @property
    def size_mm(self) -> tuple[float, float]:
        """Extent of the found points in mm."""
        return (self.grid[0] - 1) * self.pitch_mm, (self.grid[1] - 1) * self.pitch_mm

    def facts(self) -> dict[str, object]:
        """The board as it is recorded beside a calibration; of the markers what is known."""
        return {name: value for name, value in asdict(self).items() if value not in ("", None)}


@dataclass(frozen=True)
class Sighting:
    """One view of the board."""

    pixels: F8
    """[n, 2], pixel centres at integers."""
    board_mm: F8
    """[n, 2] of the same points on the board; of a part of a chessboard the offset is arbitrary."""
    whole: bool
    """True if all points were found, so that the origin is the middle of the board."""
    pitch_px: float
    """Typical distance of neighbours in the picture."""
    others: Mapping[str, F8] = field(default_factory=dict)
    """The same corners [n, 2] by other estimates: ``sector`` (OpenCV's sector detector, better on small foreshortened
    squares) and ``gradient`` (cornerSubPix)."""
    estimate: str = "saddle"
    """What located ``pixels``: saddle, sector, gradient, the mean of two of them, or centre (dots)."""

    @property
    def object_mm(self) -> F8:
        """Board points [n, 3] with z = 0."""
        return np.column_stack([self.board_mm, np.zeros(len(self.board_mm))])


def find_board(image: NDArray[np.generic], board: Board) -> Sighting:
    """Find the board in a grey or RGB picture.

    Raises:
        BoardNotFoundError: no board, too little of it, or a board of another size.
    """
    grey = _grey8(image)
    if board.kind == "charuco":
        found = _charuco(grey, board)
    elif board.kind == "dots":
        found = replace(_dots(grey, board), estimate="centre")
    else:
        found = _chessboard(grey, board)
    return _facing_camera(found)


def _grey8(image: NDArray[np.generic]) -> NDArray[np.uint8]:
    grey = cv2.cvtColor(np.asarray(image), cv2.COLOR_RGB2GRAY) if image.ndim == 3 else np.asarray(image)
    if grey.dtype == np.uint8:
        return grey.astype(np.uint8)
    values = grey.astype(np.float64)
    return np.asarray(np.clip(values * (255.0 / max(values.max(), 1.0)), 0, 255).round(), dtype=np.uint8)


def _chessboard(grey: NDArray[np.uint8], board: Board) -> Sighting:
    sector, grid = _located(grey, board)
    if grid is None:
        raise BoardNotFoundError(
            f"no chessboard found ({board.columns} x {board.rows} squares expected): is it sharp, lit, in the field, "
            "and face up?"
        )
    grid = _without_false_lines(grey, _cropped(grid), board.grid)
    known = np.isfinite(grid[..., 0])
    sizes = tuple(sorted(known.any(axis=axis).sum() for axis in (0, 1)))
    wanted = tuple(sorted(board.grid))
    if sizes[0] > wanted[0] or sizes[1] > wanted[1]:
        raise LargerBoardError(
            f"the board shows at least {sizes[1] + 1} x {sizes[0] + 1} squares, more than the "
            f"{max(board.columns, board.rows)} x {min(board.columns, board.rows)} given: another board, or --squares "
            "(which counts squares, not inner corners)"
        )
    if known.sum() < MIN_CORNERS:
        raise BoardNotFoundError(f"only {known.sum()} corners are visible; at least {MIN_CORNERS} are needed")
    return _sighting(grey, grid, board, sector)


def _located(grey: NDArray[np.uint8], board: Board) -> tuple[F8 | None, F8 | None]:
    """All corners [rows, columns, 2] by the sector detector, or None; and the grid grown in the picture, or None.

    A large picture is searched in reduced ones: its grid is refined in the full picture, the sector detector's corners
    are those of the reduced one.
    """
    best, most, factor = None, 0, 1
    for level in levels(grey):
        sector = None if level.quick else _whole(level.grey, board, level.thorough)
        grid = _largest(level, board) if sector is None else grow(level.grey, sector, max(board.grid) + 2)
        count = 0 if grid is None else int(np.isfinite(grid[..., 0]).sum())
        if sector is not None or count > most:
            best, most, factor = grid, count, level.factor
        if sector is not None or most > 0.5 * board.grid[0] * board.grid[1]:
            break
    if best is None or factor == 1:
        return sector, best
    best = _cropped(best)
    if not best.size:
        return None, None
    full = refined_in_full(grey, best, factor, factor * grid_pitch_px(best))
    return None if sector is None else in_full(sector, factor), full


def _whole(grey: NDArray[np.uint8], board: Board, thorough: bool) -> F8 | None:
    """All corners [rows, columns, 2] by OpenCV's sector detector, or None."""
    small = board.grid[0] * board.grid[1] <= SMALL_GRID
    for flags in (cv2.CALIB_CB_ACCURACY, _SECTOR)[: 2 if small and thorough else 1]:
        found, corners = cv2.findChessboardCornersSB(grey, board.grid, flags=flags)
        if found:
            break
    if not found:
        return None
    return np.asarray(corners, dtype=np.float64).reshape(board.grid[1], board.grid[0], 2)


def _largest(level: Level, board: Board) -> F8 | None:
    """Corners [rows, columns, 2], NaN where unknown, grown from the best seed; None where there is no seed."""
    limit = max(board.grid) + 2
    best, most = None, 0
    for attempt, seed in enumerate(_seeds(level, board)):
        grid = grow(level.grey, seed, limit)
        count = int(np.isfinite(grid[..., 0]).sum())
        if count > most:
            best, most = grid, count
        if most > 0.5 * board.grid[0] * board.grid[1] or (attempt >= SEED_ATTEMPTS and most >= MIN_CORNERS):
            break
    return best


def _seeds(level: Level, board: Board) -> Iterator[F8]:
    """Small parts of the chessboard, [r, c, 2]; those of OpenCV's detector last: it may skip rows."""
    yield from saddle_blocks(level.grey)
    if not level.thorough:
        return
    for picture in (level.grey, cv2.createCLAHE(3.0, (6, 6)).apply(level.grey)):
        for side in SEED_SIDES:
            size = (min(side, board.grid[0]), min(side, board.grid[1]))
            found, corners, meta = cv2.findChessboardCornersSBWithMeta(picture, size, _SECTOR | cv2.CALIB_CB_LARGER)
            if found:
                yield best_block(np.asarray(corners, dtype=np.float64).reshape(*meta.shape[:2], 2))


def _cropped(grid: F8) -> F8:
    """The grid without its empty margins and without border rows of one or two corners, which may be false."""
    known = np.isfinite(grid[..., 0])
    rows, columns = (np.flatnonzero(known.sum(axis=axis) >= MIN_ROW) for axis in (1, 0))
    if not rows.size or not columns.size:
        return grid[:0, :0]
    return grid[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def _without_false_lines(grey: NDArray[np.uint8], grid: F8, wanted: tuple[int, int]) -> F8:
    """The grid without border lines that make it larger than ``wanted`` corners and are hardly corners.

    Squares at the border have corners of their own towards a narrow margin, in the places of a further line. These are
    no saddles; the next line of a board that really is larger consists of saddles.
    """
    pitch_px = grid_pitch_px(grid) if min(grid.shape[:2]) > 1 else 0.0
    for _ in range(2):
        grid = grid.transpose(1, 0, 2)
        most = min(wanted) if len(grid) <= grid.shape[1] else max(wanted)
        while len(grid) > most:
            saddles = [_saddle_count(grey, line, pitch_px) for line in (grid[0], grid[-1])]
            if min(saddles) >= SADDLE_SHARE * grid.shape[1]:
                break
            grid = grid[1:] if saddles[0] <= saddles[1] else grid[:-1]
    return grid


def _saddle_count(grey: NDArray[np.uint8], line: F8, pitch_px: float) -> int:
    known = line[np.isfinite(line[:, 0])]
    return int(_steady(refine_saddles(grey, known, pitch_px), known, pitch_px).sum())


def _steady(refined: F8, pixels: F8, pitch_px: float) -> NDArray[np.bool_]:
    """Which corners have their saddle near them: [n]."""
    return np.asarray(np.linalg.norm(refined - pixels, axis=1) < max(0.15 * pitch_px, 1.0), dtype=np.bool_)


def _sighting(grey: NDArray[np.uint8], grid: F8, board: Board, sector: F8 | None) -> Sighting:
    if grid.shape[1] != board.grid[0] and grid.shape[:2] == board.grid:
        grid = grid.transpose(1, 0, 2)
    if sector is not None and sector.shape != grid.shape:
        sector = None
    if sector is not None:
        grid = np.where(np.isfinite(grid), grid, sector)
    known = np.isfinite(grid[..., 0])
    row, column = np.nonzero(known)
    pitch_px = grid_pitch_px(grid)
    pixels = grid[known]
    refined = refine_saddles(grey, pixels, pitch_px)
    steady = _steady(refined, pixels, pitch_px)
    whole = grid.shape[:2] == board.grid[::-1] and bool(known.all())
    middle = (np.array([grid.shape[1], grid.shape[0]]) - 1) / 2
    mm = (np.column_stack([column, row]) - middle) * board.pitch_mm
    others = {"gradient": _gradient(grey, pixels, pitch_px)}
    if sector is not None:
        others["sector"] = sector[known]
        if not steady.all():
            return Sighting(sector[known], mm, whole, pitch_px, others, "sector")
    return Sighting(refined[steady], mm[steady], whole, pitch_px, {name: at[steady] for name, at in others.items()})


def _gradient(grey: NDArray[np.uint8], places: F8, pitch_px: float) -> F8:
    """Corners where the gradients around them meet (OpenCV's estimate), in a window of two thirds of the pitch."""
    half = int(np.clip(pitch_px / 3, 2, 11))
    start = places.astype(np.float32).reshape(-1, 1, 2)
    found = cv2.cornerSubPix(
        grey, start, (half, half), (-1, -1), (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 60, 1e-4)
    )
    return np.asarray(found, dtype=np.float64).reshape(-1, 2)


def grid_pitch_px(grid: F8) -> float:
    """Median distance of neighbouring points of [rows, columns, 2] in px (shorter direction; NaN points ignored)."""
    across = np.linalg.norm(np.diff(grid, axis=1), axis=-1)
    down = np.linalg.norm(np.diff(grid, axis=0), axis=-1)
    return float(min(np.nanmedian(across), np.nanmedian(down)))


def _charuco(grey: NDArray[np.uint8], board: Board) -> Sighting:
    layouts = possible_layouts(board.columns, board.rows, board.dictionary, board.legacy_layout)
    found = find_corners(grey, layouts, MIN_CORNERS)
    if len(found.number) < MIN_CORNERS:
        raise BoardNotFoundError(refusal(grey, layouts, found, MIN_CORNERS))
    index, layout = found.number, found.layout
    grid = (layout.columns - 1, layout.rows - 1)
    place = np.column_stack([index % grid[0], index // grid[0]])
    pitch_px = _charuco_pitch_px(found.pixels, place)
    refined = refine_saddles(grey, found.pixels, CHARUCO_WINDOW_SHARE * pitch_px)
    pixels = np.where(np.isfinite(refined), refined, found.pixels)
    mm = (place - (np.array(grid) - 1) / 2) * board.pitch_mm
    # the origin is the middle of the board whichever part of it is seen: the markers number the corners
    return Sighting(pixels, mm, True, pitch_px)


def settled(board: Board, pictures: Iterable[NDArray[np.generic]]) -> Board:
    """The board with the dictionary and the layout of its markers, as the first of some pictures that shows it says.

    Unchanged where there is nothing to find, or no picture shows enough of it.
    """
    if board.kind != "charuco" or (board.dictionary and board.legacy_layout is not None):
        return board
    layouts = possible_layouts(board.columns, board.rows, board.dictionary, board.legacy_layout)
    for picture in islice(pictures, MOST_SETTLING):
        found = find_corners(_grey8(picture), layouts, MIN_CORNERS)
        if len(found.number) >= MIN_CORNERS:
            return replace(board, dictionary=found.layout.dictionary, legacy_layout=found.layout.legacy)
    return board


def _charuco_pitch_px(pixels: F8, place: NDArray[np.intp]) -> float:
    """Median distance of corners that are neighbours on the board; of nearest corners where none are."""
    apart = np.abs(place[:, None] - place[None]).sum(axis=2) == 1
    distance = np.linalg.norm(pixels[:, None] - pixels[None], axis=2)
    return float(np.median(distance[apart])) if apart.any() else float(np.median(_nearest(pixels)))


def _dots(grey: NDArray[np.uint8], board: Board) -> Sighting:
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.maxArea = max(parameters.maxArea, grey.size / (2 * board.columns * board.rows))
    blobs = cv2.SimpleBlobDetector.create(parameters)
    for picture in (grey, np.asarray(255 - grey, dtype=np.uint8)):
        found, centres = cv2.findCirclesGrid(picture, board.grid, flags=cv2.CALIB_CB_SYMMETRIC_GRID, blobDetector=blobs)
        if found:
            pixels = np.asarray(centres, dtype=np.float64).reshape(-1, 2)
            column, row = np.meshgrid(np.arange(board.grid[0]), np.arange(board.grid[1]))
            middle = (np.array(board.grid) - 1) / 2
            mm = (np.column_stack([column.ravel(), row.ravel()]) - middle) * board.pitch_mm
            return Sighting(pixels, mm, True, float(np.median(_nearest(pixels))))
    raise BoardNotFoundError(f"no grid of {board.columns} x {board.rows} dots found: all of it has to be in the field")


def _nearest(points: F8) -> F8:
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    nearest: F8 = distance.min(axis=1)
    return nearest


def _facing_camera(sighting: Sighting) -> Sighting:
    """The sighting with x to the right in the picture and y up, as near as the grid allows."""
    # then z = x cross y points at the camera
    fit = np.linalg.lstsq(
        np.column_stack([sighting.board_mm, np.ones(len(sighting.board_mm))]), sighting.pixels, rcond=None
    )[0]
    step_x, step_y = fit[0], fit[1]
    mm = sighting.board_mm.copy()
    if step_x[0] * step_y[1] - step_x[1] * step_y[0] > 0:
        mm[:, 1] *= -1
        step_y = -step_y
    angles = np.arctan2(-step_x[1], step_x[0])
    quarter = round(float(angles) / (np.pi / 2)) % 4
    for _ in range(quarter):
        mm = np.column_stack([-mm[:, 1], mm[:, 0]])
    return replace(sighting, board_mm=mm)
