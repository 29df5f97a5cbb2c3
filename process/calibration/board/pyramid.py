"""Coarse to fine: in which reduced pictures a large picture is searched for a chessboard, and corners taken back.

A picture of up to SEARCH_SIDE_PX is searched as it is. OpenCV's detectors take 20 s and more for 12 megapixels, and a
minute or two where there is no board; corners are refined in the full picture anyway.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]
SEARCH_SIDE_PX = 2000
"""Longer side up to which a picture is searched as it is."""
LEVEL_SIDES_PX = (1600, 800)
"""Longer sides to which larger ones are reduced, in the order of the search."""
_TERMINATE = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 40, 1e-4)


@dataclass(frozen=True)
class Level:
    """A picture to search."""

    grey: NDArray[np.uint8]
    factor: int
    """Pixels of the full picture for one of this, in each direction."""
    thorough: bool
    """True if slow searches are affordable."""
    quick: bool = False
    """True if only the quickest search is."""


def levels(grey: NDArray[np.uint8]) -> Iterator[Level]:
    """The pictures to search, in order: the picture itself, or reduced ones, and between them half of it."""
    side = max(grey.shape)
    if side <= SEARCH_SIDE_PX:
        yield Level(grey, 1, True)
        return
    factors = [-(-side // most) for most in LEVEL_SIDES_PX]
    for factor in factors:
        yield Level(reduced(grey, factor), factor, factor == factors[-1])
    if factors[0] > 2:  # squares of a few pixels are lost in the reduced ones
        yield Level(reduced(grey, 2), 2, False, quick=True)


def reduced(grey: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    """The picture with the mean of each ``factor`` x ``factor`` pixels; a rest at the right and below is cut off."""
    height, width = (length // factor for length in grey.shape)
    whole = grey[: height * factor, : width * factor]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def in_full(places: F8, factor: int) -> F8:
    """Places [..., 2] of a reduced picture in px of the full one."""
    return (places + 0.5) * factor - 0.5


def refined_in_full(grey: NDArray[np.uint8], grid: F8, factor: int, pitch_px: float) -> F8:
    """Corners [rows, columns, 2] of a reduced picture (NaN where none is), found again in the full one.

    ``pitch_px`` is the distance of neighbours in the full picture.
    """
    full = in_full(grid, factor)
    known = np.isfinite(grid[..., 0])
    half = int(np.clip(0.25 * pitch_px, 2, 4 * factor))
    start = np.ascontiguousarray(full[known], dtype=np.float32).reshape(-1, 1, 2)
    full[known] = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), _TERMINATE).reshape(-1, 2)
    return full
