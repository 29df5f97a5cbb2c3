"""A camera picture as grey levels for terminal cells: area means, hysteresis against noise, clipping marked; pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LEVELS = 16
CLIPPED_COUNTS = 254
"""From this value on a pixel of the reduced picture counts as clipped."""
AVERAGE = 0.3
"""Weight of the newest picture in the running average of a still scene."""

Grey = NDArray[np.float32]


@dataclass(frozen=True)
class PictureDetail:
    """How fine a picture is drawn; coarser costs fewer bytes."""

    levels: int
    """Grey levels."""
    block: int
    """Side of the square of half cells that share one value."""


FULL = PictureDetail(LEVELS, 1)
DETAILS: tuple[PictureDetail, ...] = (FULL, PictureDetail(8, 1), PictureDetail(8, 2), PictureDetail(6, 4))
"""From fine to coarse."""


def half_cells_for(source_height: float, source_width: float, rows: int, columns: int) -> tuple[int, int]:
    """Height (even, in half cells) and width (in cells) of the picture in ``rows`` x ``columns`` cells.

    A cell is taken to be twice as high as it is wide.
    """
    if rows < 1 or columns < 1:
        return 0, 0
    scale = min(2 * rows / source_height, columns / source_width)
    height = max(2, int(source_height * scale) // 2 * 2)
    return min(height, 2 * rows), max(1, min(columns, round(source_width * scale)))


def to_grey(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """[h, w] of a grey or RGB picture (ITU-R BT.601 weights)."""
    if pixels.ndim == 2:
        return pixels
    weighted: NDArray[np.uint8] = (pixels @ np.array([0.299, 0.587, 0.114], np.float32)).astype(np.uint8)
    return weighted


def reduce_to(pixels: NDArray[np.uint8], height: int, width: int) -> tuple[Grey, NDArray[np.bool_]]:
    """Means over the areas of a ``height`` x ``width`` grid, and where an area contains a clipped pixel."""
    ys, xs = _edges(pixels.shape[0], height), _edges(pixels.shape[1], width)
    sums = np.add.reduceat(np.add.reduceat(pixels.astype(np.uint32), ys, axis=0), xs, axis=1)
    counts = np.outer(_lengths(ys, pixels.shape[0]), _lengths(xs, pixels.shape[1]))
    peaks = np.maximum.reduceat(np.maximum.reduceat(pixels, ys, axis=0), xs, axis=1)
    return (sums / counts).astype(np.float32), peaks >= CLIPPED_COUNTS


def _edges(length: int, parts: int) -> NDArray[np.intp]:
    return (np.arange(parts) * length // parts).astype(np.intp)


def _lengths(edges: NDArray[np.intp], length: int) -> NDArray[np.intp]:
    # where the grid is finer than the picture, reduceat takes the one pixel at the edge
    return np.maximum(1, np.diff(edges, append=length))


class Raster:
    """The levels on the screen. A cell changes only if it is wrong by more than noise explains: still scenes cost
    nothing, moving ones at most one repaint.
    """

    def __init__(self) -> None:
        self.levels: NDArray[np.uint8] = np.zeros((0, 0), np.uint8)
        """[2 x rows, columns], 0 to ``count`` - 1."""
        self.clipped: NDArray[np.bool_] = np.zeros((0, 0), np.bool_)
        """[2 x rows, columns]: where the mark for clipping goes."""
        self.count = LEVELS
        self._average: Grey = np.zeros((0, 0), np.float32)
        self._at_steps: int | None = None

    def update(
        self, pixels: NDArray[np.uint8], height: int, width: int, detail: PictureDetail, at_steps: int
    ) -> NDArray[np.intp]:
        """Take a picture; returns the rows of cells (pairs of half cells) that look different now.

        ``at_steps``: position of the stage; where it changed, the running average starts again.
        """
        small = (-(-height // detail.block), -(-width // detail.block))
        means, clipped = reduce_to(to_grey(pixels), *small)
        fresh = means.shape != self._average.shape or detail.levels != self.count
        moved = at_steps != self._at_steps
        self._average = means if fresh or moved else self._average + AVERAGE * (means - self._average)
        self._at_steps, self.count = at_steps, detail.levels
        return self._show(means, clipped, (height, width), detail, fresh)

    def _show(
        self, means: Grey, clipped: NDArray[np.bool_], shape: tuple[int, int], detail: PictureDetail, fresh: bool
    ) -> NDArray[np.intp]:
        step = 255.0 / (detail.levels - 1)
        now = _enlarged(np.rint(means / step).astype(np.uint8), shape, detail.block)
        marks = _enlarged(clipped, shape, detail.block)
        if fresh or self.levels.shape != shape:
            self.levels, self.clipped = now, marks
            return np.arange(shape[0] // 2)
        shown = self.levels.astype(np.float32) * step
        # a single picture must be off by two levels (noise explains one), the average over a still scene by one
        off = np.abs(_enlarged(means, shape, detail.block) - shown) >= 2.0 * step
        settled = _enlarged(self._average, shape, detail.block)
        off_on_average = np.abs(settled - shown) >= step
        change = off | off_on_average | (marks != self.clipped)
        rows: NDArray[np.intp] = np.flatnonzero(change.reshape(shape[0] // 2, -1).any(axis=1))
        better = np.where(off, now, np.rint(settled / step).astype(np.uint8))
        self.levels = np.where(change, better, self.levels)
        self.clipped = marks
        return rows


def _enlarged(values: NDArray, shape: tuple[int, int], block: int) -> NDArray:
    if block == 1:
        return values
    return np.repeat(np.repeat(values, block, axis=0), block, axis=1)[: shape[0], : shape[1]]


def sharpness(pixels: NDArray[np.uint8]) -> float:
    """Mean squared difference of neighbours over the mean brightness, in counts: larger is sharper; for comparing."""
    grey = to_grey(pixels).astype(np.float32)
    mean = float(grey.mean())
    if mean < 1.0 or min(grey.shape) < 2:
        return 0.0
    return float(np.mean(np.diff(grey, axis=0) ** 2) + np.mean(np.diff(grey, axis=1) ** 2)) / mean


def runs(codes: NDArray[np.int32], apart: int) -> list[tuple[int, int]]:
    """Begin and end of the runs of equal values; the cell ``apart`` (-1: none) is a run of its own."""
    breaks = np.flatnonzero(np.diff(codes)) + 1
    if apart >= 0:
        breaks = np.union1d(breaks, [index for index in (apart, apart + 1) if 0 < index < len(codes)])
    edges = [0, *breaks.tolist(), len(codes)]
    return list(zip(edges[:-1], edges[1:], strict=True))
