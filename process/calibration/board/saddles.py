"""Saddle points of the brightness: the first corners of a partial chessboard, and sub-pixel refinement."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]
MOST_POINTS = 4000
MOST_SEEDS = 12
SMOOTHING_PX = (1.2, 2.5)
"""Smoothing widths at which saddles are searched: for sharp pictures, then for blurred ones."""
NEAR_SHARE = 0.12
"""Largest distance of a saddle from its predicted place, as a share of the pitch."""


def saddle_blocks(grey: NDArray[np.uint8]) -> Iterator[F8]:
    """Blocks [3, 3, 2] of neighbouring corners, from different places of the picture."""
    for width in SMOOTHING_PX:
        points = _saddles(grey, width)
        if len(points) < 9:
            continue
        found: list[F8] = []
        order = np.random.default_rng(0).permutation(len(points))
        for index in order:
            block = _block(points, int(index))
            if block is not None and all(_apart(block, other) for other in found):
                found.append(block)
                yield block
            if len(found) >= MOST_SEEDS:
                break


def _saddles(grey: NDArray[np.uint8], width: float) -> F8:
    """Places [n, 2] (whole pixels) where the brightness curves up in one direction and down in the other."""
    soft = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), width)
    second = [cv2.Sobel(soft, cv2.CV_32F, *order, ksize=3) for order in ((2, 0), (0, 2), (1, 1))]
    # strength of a saddle: minus the determinant of the Hessian, the mixed term weighted by 4
    saddle = np.maximum(second[2] ** 2 * 4.0 - second[0] * second[1], 0)
    peak = (saddle == cv2.dilate(saddle, np.ones((5, 5), np.uint8))) & (saddle > 0)
    peak[:3], peak[-3:], peak[:, :3], peak[:, -3:] = False, False, False, False
    row, column = np.nonzero(peak)
    if not len(row):
        return np.empty((0, 2))
    strength = saddle[row, column]
    strongest = np.argsort(strength)[::-1][:MOST_POINTS]
    strongest = strongest[strength[strongest] > 0.2 * strength[strongest[: max(len(strongest) // 10, 1)]].mean()]
    return np.column_stack([column, row])[strongest].astype(np.float64)


def _block(points: F8, index: int) -> F8 | None:
    """The 3 x 3 corners around one of ``points``, from its nearest neighbour and the one at right angles to it."""
    place = points[index]
    offset = points - place
    distance = np.linalg.norm(offset, axis=1)
    distance[index] = np.inf
    first = offset[int(distance.argmin())]
    length = float(np.linalg.norm(first))
    across = np.abs(offset @ np.array([-first[1], first[0]])) / np.maximum(distance, 1e-9) / length
    beside = (across > 0.75) & (distance < 2.2 * length)
    if length < 4 or not beside.any():
        return None
    second = offset[int(np.where(beside, distance, np.inf).argmin())]
    block = np.empty((3, 3, 2))
    for row in (-1, 0, 1):
        for column in (-1, 0, 1):
            gap = np.linalg.norm(offset - (row * first + column * second), axis=1)
            nearest = int(gap.argmin())
            if gap[nearest] > max(NEAR_SHARE * length, 1.6):
                return None
            block[row + 1, column + 1] = points[nearest]
    return block


def _apart(block: F8, other: F8) -> bool:
    pitch = np.linalg.norm(block[1, 2] - block[1, 1])
    return float(np.linalg.norm(block[1, 1] - other[1, 1])) > 3 * float(pitch)


def refine_saddles(grey: NDArray[np.uint8], places: F8, pitch_px: float) -> F8:
    """Saddle points of a quadratic fitted to the smoothed picture around each of ``places`` [n, 2], sub-pixel.

    Unbiased for a corner that is symmetric about its middle; a half to a third of the noise of the gradient method on
    synthetic boards. NaN where there is no saddle within a third of the pitch.
    """
    half = int(np.clip(round(0.34 * pitch_px), 2, 14))
    soft = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), max(pitch_px / 12, 0.8))
    y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64).reshape(2, -1)
    weight = np.exp(-(x * x + y * y) / (2 * (half / 1.7) ** 2))
    design = np.column_stack([x * x, x * y, y * y, x, y, np.ones(len(x))])
    # weighted least squares as one matrix: the window is the same for every corner
    solve = np.linalg.pinv(design * weight[:, None]) * weight
    side = 2 * half + 1
    found: F8 = np.array(places, dtype=np.float64)
    for _ in range(4):
        for index, place in enumerate(found):
            if not np.isfinite(place).all():
                continue
            patch = cv2.getRectSubPix(soft, (side, side), (float(place[0]), float(place[1])))
            xx, xy, yy, along_x, along_y, _ = solve @ patch.ravel().astype(np.float64)
            bend = 4 * xx * yy - xy * xy
            if bend >= 0:
                found[index] = np.nan
                continue
            step = np.array([xy * along_y - 2 * yy * along_x, xy * along_x - 2 * xx * along_y]) / bend
            found[index] = place + step if np.abs(step).max() < half else np.nan
    found[np.linalg.norm(found - places, axis=1) > max(pitch_px / 3, 1.0)] = np.nan
    return found
