"""The four maps of a scan as they are shown: mask and counts for a contrast, zoom, values under a cursor; pure."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from acquire.contract.colormaps import MapName

F4 = NDArray[np.float32]
MEDIAN_PX = 5
"""Default side of the median filter on the mask."""
MAX_ZOOM = 64


class MapKind(StrEnum):
    """The four maps."""

    MINIMUM = "minimum"
    MAXIMUM = "maximum"
    MASK = "contrast mask"
    CROSSING = "crossing time"


@dataclass(frozen=True, eq=False)
class MapSet:
    """Minimum, maximum and crossing of every ``step``-th pixel."""

    minimum: NDArray[np.uint16]
    """[h, w] in counts of the stored depth."""
    maximum: NDArray[np.uint16]
    """[h, w] in counts of the stored depth."""
    crossing: F4
    """[h, w] fractional 0-based frame index; NaN where there is none."""
    step: int
    """Distance of the samples in pixels of the camera."""
    contrast: int
    """ThresholdCounts of 8 bit over which crossings were estimated: below it nothing is known of them."""
    bit_depth: int
    folded_through: int
    """Index of the last folded frame; -1 for none."""
    frames: int
    """Frames of the sweep; 0 where unknown."""
    median_px: int = MEDIAN_PX
    """Side of the median filter on the mask in pixels of the camera; 0 for none."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of samples."""
        return self.minimum.shape[0], self.minimum.shape[1]

    @property
    def unit(self) -> int:
        """ThresholdCounts of the stored depth in one count of 8 bit."""
        return int(2 ** (self.bit_depth - 8))


@dataclass(frozen=True)
class ThresholdCounts:
    """What a threshold leaves, in pixels of the camera; a sample of sampled maps counts for all pixels around it."""

    over_contrast: int
    with_crossing: int
    share: float
    """Share of the picture over the contrast, 0..1."""
    exact: bool
    """False: samples stand for their neighbours, or the contrast is below the threshold of the fold."""


def mask_of(maps: MapSet, contrast: int) -> NDArray[np.bool_]:
    """[h, w] where maximum - minimum is at least ``contrast`` (counts of 8 bit), after the median."""
    mask = maps.maximum - maps.minimum >= contrast * maps.unit
    side = maps.median_px if maps.step == 1 else _odd(maps.median_px / maps.step)
    return _majority(mask, side) if side > 1 else mask


def _odd(side: float) -> int:
    return 2 * round((side - 1) / 2) + 1 if side > 1 else 1


def _majority(mask: NDArray[np.bool_], side: int) -> NDArray[np.bool_]:
    """The median filter of a mask in squares of ``side``; at the border the outermost samples are repeated."""
    # sums over the squares from the summed-area table
    half = side // 2
    padded = np.pad(mask, half, mode="edge").astype(np.int32)
    sums = np.zeros((padded.shape[0] + 1, padded.shape[1] + 1), np.int32)
    sums[1:, 1:] = padded.cumsum(axis=0).cumsum(axis=1)
    box = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
    return box > side * side // 2


def counts_of(maps: MapSet, mask: NDArray[np.bool_], contrast: int) -> ThresholdCounts:
    """Counts of a mask that was made with ``contrast``."""
    pixels = maps.step * maps.step
    over = int(np.count_nonzero(mask))
    crossing = int(np.count_nonzero(mask & np.isfinite(maps.crossing)))
    exact = maps.step == 1 and contrast >= maps.contrast
    return ThresholdCounts(over * pixels, crossing * pixels, over / max(1, mask.size), exact)


def histogram(maps: MapSet, bins: int) -> NDArray[np.int64]:
    """Samples by maximum - minimum over 0..255 counts of 8 bit, [bins]."""
    contrast = ((maps.maximum - maps.minimum) // maps.unit).astype(np.int64).ravel()
    return np.bincount(np.minimum(contrast * bins // 256, bins - 1), minlength=bins)


@dataclass(frozen=True)
class MapLayer:
    """One map, ready to be drawn."""

    kind: MapKind
    values: F4
    """[h, w]; NaN where there is none."""
    low: float
    high: float
    """The fixed range of the colours."""
    colours: MapName | None
    """None: grey, black to white."""
    unit: str


def layers_of(maps: MapSet, mask: NDArray[np.bool_]) -> tuple[MapLayer, MapLayer, MapLayer, MapLayer]:
    """The four maps with their ranges: intensities over the whole depth, crossings over the whole sweep."""
    full = float(2**maps.bit_depth - 1)
    last = float(max(maps.frames - 1, maps.folded_through, 1))
    crossing = np.where(mask, maps.crossing, np.float32(np.nan))
    return (
        MapLayer(MapKind.MINIMUM, maps.minimum.astype(np.float32), 0.0, full, None, "counts"),
        MapLayer(MapKind.MAXIMUM, maps.maximum.astype(np.float32), 0.0, full, None, "counts"),
        MapLayer(MapKind.MASK, mask.astype(np.float32), 0.0, 1.0, None, ""),
        MapLayer(MapKind.CROSSING, crossing, 0.0, last, "cividis", "frames"),
    )


@dataclass(frozen=True)
class MapWindow:
    """The visible part of the maps, in samples; the cursor is a sample in it."""

    rows: int
    columns: int
    """Size of the maps."""
    zoom: int = 1
    """1 shows everything; each step doubles it."""
    row: int = 0
    column: int = 0
    """The cursor."""
    top: float = 0.0
    left: float = 0.0

    @property
    def height(self) -> float:
        """Rows in view."""
        return max(1.0, self.rows / self.zoom)

    @property
    def width(self) -> float:
        """Columns in view."""
        return max(1.0, self.columns / self.zoom)

    def moved(self, down: int, right: int) -> MapWindow:
        """The cursor moved; what is in view follows it."""
        row = min(max(0, self.row + down), self.rows - 1)
        column = min(max(0, self.column + right), self.columns - 1)
        return replace(self, row=row, column=column)._following()

    def zoomed(self, steps: int) -> MapWindow:
        """Nearer (1) or further (-1), about the cursor."""
        zoom = min(MAX_ZOOM, self.zoom * 2) if steps > 0 else max(1, self.zoom // 2)
        found = replace(self, zoom=zoom)
        return replace(found, top=self.row + 0.5 - found.height / 2, left=self.column + 0.5 - found.width / 2)._inside()

    def stride(self, cells: int) -> int:
        """Samples per press of an arrow: about one cell of a map that is drawn ``cells`` wide."""
        return max(1, round(self.width / max(1, cells)))

    def _following(self) -> MapWindow:
        top = min(max(self.top, self.row + 1 - self.height), float(self.row))
        left = min(max(self.left, self.column + 1 - self.width), float(self.column))
        return replace(self, top=top, left=left)._inside()

    def _inside(self) -> MapWindow:
        top = min(max(0.0, self.top), self.rows - self.height)
        return replace(self, top=top, left=min(max(0.0, self.left), self.columns - self.width))


def window_on(maps: MapSet, before: MapWindow | None = None) -> MapWindow:
    """The window ``before`` if the maps have the same size, else one on all of them with the cursor in the middle."""
    rows, columns = maps.shape
    if before is not None and (before.rows, before.columns) == (rows, columns):
        return before
    return MapWindow(rows, columns, row=rows // 2, column=columns // 2)


def cells_of(values: F4, window: MapWindow, height: int, width: int) -> F4:
    """Means of the visible values in ``height`` x ``width`` cells; NaN where a cell contains no value."""
    rows = _edges(window.top, window.height, window.rows, height)
    columns = _edges(window.left, window.width, window.columns, width)
    part = values[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    known = np.isfinite(part)
    sums, counts = (_summed(array, rows, columns) for array in (np.where(known, part, 0.0), known.astype(np.float64)))
    with np.errstate(invalid="ignore"):
        return np.where(counts > 0, sums / counts, np.nan).astype(np.float32)


def _edges(start: float, extent: float, size: int, cells: int) -> NDArray[np.intp]:
    """First sample of each cell, then the last visible sample: [cells + 1]."""
    first = np.floor(start + extent * np.arange(cells) / cells).astype(np.intp)
    return np.append(np.clip(first, 0, size - 1), min(size - 1, math.ceil(start + extent) - 1))


def _summed(array: NDArray[np.float64], rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[np.float64]:
    by_row = np.add.reduceat(array, rows[:-1] - rows[0], axis=0)
    return np.add.reduceat(by_row, columns[:-1] - columns[0], axis=1)


def cell_of_cursor(window: MapWindow, height: int, width: int) -> tuple[int, int]:
    """Row and column of the cell that contains the cursor."""
    row = int((window.row + 0.5 - window.top) / window.height * height)
    column = int((window.column + 0.5 - window.left) / window.width * width)
    return min(max(0, row), height - 1), min(max(0, column), width - 1)


def sample_at(window: MapWindow, row: int, column: int, height: int, width: int) -> MapWindow:
    """The window with the cursor on the sample in the middle of a cell."""
    found_row = int(window.top + (row + 0.5) / height * window.height)
    found_column = int(window.left + (column + 0.5) / width * window.width)
    return window.moved(found_row - window.row, found_column - window.column)


def pixel_words(maps: MapSet, mask: NDArray[np.bool_], window: MapWindow) -> str:
    """The values under the cursor in one line; x and y in pixels of the camera from the upper left one."""
    place = (window.row, window.column)
    low, high = int(maps.minimum[place]), int(maps.maximum[place])
    inside, crossing = bool(mask[place]), float(maps.crossing[place])
    return (
        f"x {window.column * maps.step}  y {window.row * maps.step}  min {low}  max {high}  "
        f"contrast {(high - low) / maps.unit:.0f} ({'over' if inside else 'under'})  "
        f"crossing {f'{crossing:.2f}' if inside and math.isfinite(crossing) else 'none'}"
    )
