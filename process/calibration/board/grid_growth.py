"""Growing a small chessboard grid over all of the board that a picture shows: partial, cut, unevenly lit."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]
REACH = 2
"""Half side of the square of cells whose corners predict a candidate."""
MIN_KNOWN = 5
CONTRAST_SHARE = 0.5
"""Least contrast between the dark and the bright squares around a corner, relative to that of its neighbours."""
_TERMINATE = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 1e-3)


def grow(grey: NDArray[np.uint8], seed: F8, limit: int) -> F8:
    """Corners [rows, columns, 2] (NaN where none is) grown from ``seed`` until no neighbour is a corner.

    A candidate is predicted by an affine fit to its known neighbours and refined. It is accepted if it stays near the
    prediction and its four squares alternate as a corner of this parity has to.

    Args:
        grey: the picture.
        seed: [r, c, 2] corners, all known.
        limit: most cells that the grid grows to each side.
    """
    soft = cv2.GaussianBlur(grey, (0, 0), 1.0).astype(np.float64)
    grid = np.full((seed.shape[0] + 2 * limit, seed.shape[1] + 2 * limit, 2), np.nan)
    grid[limit : limit + seed.shape[0], limit : limit + seed.shape[1]] = seed
    contrast = _alternations(soft, grid)
    with np.errstate(invalid="ignore", divide="ignore"):
        wrong = ~(contrast / np.nanmedian(contrast) > CONTRAST_SHARE) if np.isfinite(contrast).any() else False
    grid[wrong], contrast[wrong] = np.nan, np.nan
    rejected = np.zeros(grid.shape[:2], dtype=np.bool_)
    for _ in range(2 * limit):
        known = np.isfinite(grid[..., 0])
        border = cv2.dilate(known.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))) > 0
        candidates = np.argwhere(border & ~known & ~rejected)
        accepted = 0
        for cell in candidates:
            corner = _candidate(grey, soft, grid, (int(cell[0]), int(cell[1])), contrast)
            if corner is None:
                rejected[tuple(cell)] = True
            else:
                grid[tuple(cell)], contrast[tuple(cell)] = corner
                accepted += 1
                rejected[_around((int(cell[0]), int(cell[1])))] = False
        if not accepted:
            break
    return grid


def _around(cell: tuple[int, int]) -> tuple[slice, slice]:
    return slice(max(cell[0] - REACH, 0), cell[0] + REACH + 1), slice(max(cell[1] - REACH, 0), cell[1] + REACH + 1)


def _local_fit(grid: F8, cell: tuple[int, int]) -> F8 | None:
    """Affine map [3, 2] (row step, column step, place) around ``cell`` from its known neighbours, without itself."""
    low_r, low_c = max(cell[0] - REACH, 0), max(cell[1] - REACH, 0)
    part = grid[low_r : cell[0] + REACH + 1, low_c : cell[1] + REACH + 1]
    known = np.isfinite(part[..., 0])
    if low_r <= cell[0] and low_c <= cell[1]:
        known[cell[0] - low_r, cell[1] - low_c] = False
    row, column = np.nonzero(known)
    if len(row) < MIN_KNOWN or len(set(row)) < 2 or len(set(column)) < 2:
        return None
    design = np.column_stack([row + low_r - cell[0], column + low_c - cell[1], np.ones(len(row))])
    fit = np.linalg.lstsq(design, part[known], rcond=None)[0]
    return np.asarray(fit, dtype=np.float64)


def _squares(soft: F8, place: F8, fit: F8) -> F8 | None:
    """Brightness of the four squares around a corner: (+,+), (+,-), (-,+), (-,-); None outside the picture."""
    quarters = np.array([(a, b) for a in (0.4, -0.4) for b in (0.4, -0.4)]) @ fit[:2] + place
    column, row = np.rint(quarters).astype(int).T
    if (row < 1).any() or (column < 1).any() or (row >= soft.shape[0] - 1).any() or (column >= soft.shape[1] - 1).any():
        return None
    values: F8 = soft[row, column]
    return values


def _alternation(values: F8) -> float:
    """Darkest bright minus brightest dark square, signed by which diagonal is bright; 0 if they do not alternate."""
    first, second = values[[0, 3]], values[[1, 2]]
    if first.min() > second.max():
        return float(first.min() - second.max())
    return -float(second.min() - first.max()) if second.min() > first.max() else 0.0


def _sign(cell: tuple[int, int]) -> int:
    return 1 if (cell[0] + cell[1]) % 2 == 0 else -1


def _alternations(soft: F8, grid: F8) -> F8:
    """Signed contrast of each known corner [rows, columns]: the same sign everywhere on a chessboard."""
    found = np.full(grid.shape[:2], np.nan)
    for row, column in np.argwhere(np.isfinite(grid[..., 0])):
        cell = (int(row), int(column))
        fit = _local_fit(grid, cell)
        values = None if fit is None else _squares(soft, grid[cell], fit)
        if values is not None:
            found[cell] = _alternation(values) * _sign(cell)
    return found


def _candidate(
    grey: NDArray[np.uint8], soft: F8, grid: F8, cell: tuple[int, int], contrast: F8
) -> tuple[F8, float] | None:
    """Place and signed contrast of the corner at ``cell``; None if there is no corner."""
    fit = _local_fit(grid, cell)
    if fit is None:
        return None
    pitch = float(min(np.linalg.norm(fit[0]), np.linalg.norm(fit[1])))
    half = int(np.clip(round(0.3 * pitch), 2, 10))
    height, width = grey.shape
    if not (half + 1 < fit[2][0] < width - half - 2 and half + 1 < fit[2][1] < height - half - 2):
        return None
    start = fit[2].astype(np.float32).reshape(1, 1, 2)
    place = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), _TERMINATE).reshape(2).astype(np.float64)
    if np.linalg.norm(place - fit[2]) > max(0.25 * pitch, 1.0):
        return None
    values = _squares(soft, place, fit)
    if values is None:
        return None
    reach = _around(cell)
    around = float(np.nanmedian(contrast[reach])) if np.isfinite(contrast[reach]).any() else 0.0
    own = _alternation(values) * _sign(cell)
    return (place, own) if around != 0 and own / around > CONTRAST_SHARE else None


def best_block(grid: F8, side: int = 5) -> F8:
    """The most regular block of ``side`` x ``side`` cells (or less): far cells of the detector may be wrong."""
    rows, columns = min(side, grid.shape[0]), min(side, grid.shape[1])
    cells = np.argwhere(np.ones((rows, columns))) - [rows // 2, columns // 2]
    design = np.column_stack([cells, cells[:, 0] * cells[:, 1], np.ones(len(cells))])
    best, least = grid[:rows, :columns], np.inf
    for row in range(grid.shape[0] - rows + 1):
        for column in range(grid.shape[1] - columns + 1):
            block = grid[row : row + rows, column : column + columns]
            places = block.reshape(-1, 2)
            fit = np.linalg.lstsq(design, places, rcond=None)[0]
            area = abs(fit[0, 0] * fit[1, 1] - fit[0, 1] * fit[1, 0])
            error = np.abs(design @ fit - places).max() / np.sqrt(area) if area > 1 else np.inf
            if error < least:
                best, least = block, float(error)
    return best
