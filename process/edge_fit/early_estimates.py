"""Edge fits made while a sweep still runs, of pixels whose edge has passed, so that less is left to do at its end.

They save time and never change the result: an estimate is a function of its pixel's own frames, its first frame at half
brightness and the weighting of the scan, and it is kept only where no later frame can change it
(docs/decisions/0010-fit-edges-during-the-sweep.md). Places are numbers of frames among the folded ones, int64.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from process.crossings.maps import Maps
from process.edge_fit.noise_model import NoiseModel
from process.edge_fit.pixel_kernels import (
    ASKED,
    COLUMNS,
    FAR,
    FITTED,
    LOCAL,
    MOST_EXTENT,
    NOTHING,
    estimate_rows,
    follow_rows,
)
from process.edge_fit.weighting import EdgeWeighting, FrameSequence, WeightingFinder

AT_ONCE = 256
"""Pixels estimated at once: a few milliseconds of work."""
FOLLOWED_AT_ONCE = 4096
"""Pixels whose later light is followed at once, likewise."""
FIRST_AGE = 16
"""Frames after a crossing at which its pixel is first estimated."""
LATER = 4
"""Frames waited for beyond those that an estimate asked for: with more samples it may ask for more."""
STALE = 16
"""Frames that may arrive before the light of a pixel is followed further."""
TABLE_BYTES = 96_000_000
"""Most bytes of estimates kept; all others are made at the end of the scan."""

I8 = NDArray[np.int64]


class EdgeEstimates(NamedTuple):
    """Estimates of pixels."""

    outcome: I8
    """[p], one of ``pixel_kernels.NOTHING, FITTED, LOCAL, NOISE``."""
    columns: NDArray[np.float64]
    """[p, COLUMNS], see ``pixel_kernels.LOW`` and the following."""
    seen: I8
    """[p], place up to which the light was followed; 0 where the outcome is NOTHING."""

    @classmethod
    def empty(cls, pixels: int) -> EdgeEstimates:
        """Estimates without any outcome."""
        return cls(np.full(pixels, NOTHING), np.zeros((pixels, COLUMNS)), np.zeros(pixels, np.int64))

    def take(self, some: I8) -> EdgeEstimates:
        """A copy of some of them, [q] indices."""
        return EdgeEstimates(self.outcome[some], self.columns[some], self.seen[some])


def search_window(start: I8, frames: int) -> tuple[I8, I8]:
    """First and end place of the frames in which the edge of a first crossing is looked for."""
    return np.maximum(start - FAR, 0), np.minimum(start + FAR, frames)


def estimate_pixels(
    sequence: FrameSequence,
    weighting: EdgeWeighting,
    pixels: I8,
    start: I8,
    extent: NDArray[np.float64],
    *,
    local: bool,
    early: bool = False,
) -> EdgeEstimates:
    """Estimate the edges of some pixels from their frames (``pixel_kernels.estimate_rows``).

    Args:
        sequence: the frames.
        weighting: noise and sharp width of the scan.
        pixels: [p] flat indices.
        start: [p] place of the first frame at or above half brightness.
        extent: [p] range of the pixel over the sweep, levels.
        local: sharp or uneven edges get their crossing from the two samples beside it.
        early: more frames are to come; estimates that they could change get the outcome NOTHING.
    """
    found = EdgeEstimates.empty(len(pixels))
    if not len(pixels):
        return found
    first, end = search_window(start, len(sequence.present))
    rows = sequence.columns(pixels, first, end)
    options = (weighting.noise_coefficients(sequence), weighting.sharp_width, local, early)
    estimate_rows(
        rows, sequence.full, sequence.times, first, end, start, extent, *options, found.outcome, found.columns
    )
    found.seen[:] = end
    return found


def follow_pixels(
    sequence: FrameSequence, weighting: EdgeWeighting, pixels: I8, start: I8, found: EdgeEstimates
) -> None:
    """Follow the later light of pixels with an estimate to the end of their search window; changes ``found``."""
    _, end = search_window(start, len(sequence.present))
    some = np.flatnonzero((found.seen < end) & (found.outcome == FITTED))
    if not len(some):
        return
    first, end, outcome, columns = found.seen[some], end[some], found.outcome[some], found.columns[some]
    rows = sequence.columns(pixels[some], first, end)
    follow_rows(
        rows, sequence.full, sequence.times, first, end, weighting.noise_coefficients(sequence), outcome, columns
    )
    found.columns[some], found.seen[some] = columns, end


class EarlyEstimates:
    """The early estimates of one sweep. One thread at a time."""

    def __init__(self, shape: tuple[int, int], fallback: NoiseModel, *, local: bool) -> None:
        """shape: (height, width); fallback: noise where the frames do not tell; local: as in estimate_pixels."""
        self.weighting_finder = WeightingFinder(shape, fallback)
        self._local = local
        pixels = shape[0] * shape[1]
        self._entry: NDArray[np.int32] = np.full(pixels, -1, np.int32)
        """[pixels] row of the table with a pixel's estimate; -1 for none."""
        self._due: NDArray[np.int32] = np.zeros(pixels, np.int32)
        """[pixels] number of folded frames from which on the pixel is tried again."""
        room = min(pixels, TABLE_BYTES // (8 * COLUMNS + 32))
        self._pixel, self._start = np.empty(room, np.int64), np.empty(room, np.int64)
        self._table = EdgeEstimates.empty(room)
        self.kept = 0
        """Rows in use of the table."""
        self._queue: list[tuple[I8, I8, NDArray[np.float64]]] = []
        self._stale: list[I8] = []

    @staticmethod
    def bytes_needed(shape: tuple[int, int]) -> int:
        """Most memory in bytes for a shape (height, width)."""
        return shape[0] * shape[1] * 8 + min(TABLE_BYTES, shape[0] * shape[1] * (8 * COLUMNS + 32))

    @property
    def busy(self) -> bool:
        """True if there is something to do."""
        return self.weighting_finder.weighting is not None and bool(self._queue or self._stale)

    def propose(self, maps: Maps, start: I8, folded: int) -> None:
        """Queue the pixels of ``maps`` whose edge has passed.

        start: [h * w] place of the first frame at or above half brightness, -1 for none; folded: number of frames.
        """
        wanted = np.flatnonzero((start >= 0) & (start + FIRST_AGE <= folded) & (self._due <= folded))
        entry = self._entry[wanted]
        wanted = wanted[(entry < 0) | (self._start[entry] != start[wanted])]
        extent = maps.maximum.ravel()[wanted].astype(np.float64) - maps.minimum.ravel()[wanted]
        cuts = range(AT_ONCE, len(wanted), AT_ONCE)
        parts = (np.split(array, cuts) for array in (wanted, start[wanted], extent))
        self._queue = list(zip(*parts, strict=True)) if len(wanted) else []
        _, end = search_window(self._start[: self.kept], folded)
        unseen = end - self._table.seen[: self.kept]
        stale = np.flatnonzero((unseen >= STALE) & (self._table.outcome[: self.kept] == FITTED))
        self._stale = np.split(stale, range(FOLLOWED_AT_ONCE, len(stale), FOLLOWED_AT_ONCE)) if len(stale) else []

    def work(self, sequence: FrameSequence) -> None:
        """Do a part of the queue with the frames of ``sequence``, all of which are committed to the file."""
        weighting = self.weighting_finder.weighting
        if weighting is None:
            return
        if self._queue:
            self._estimate(sequence, weighting, *self._queue.pop())
        elif self._stale:
            self._follow(sequence, weighting, self._stale.pop())

    def _estimate(
        self, sequence: FrameSequence, weighting: EdgeWeighting, pixels: I8, start: I8, extent: NDArray[np.float64]
    ) -> None:
        frames = len(sequence.present)
        there = start < frames
        pixels, start, extent = pixels[there], start[there], extent[there]
        found = estimate_pixels(sequence, weighting, pixels, start, extent, local=self._local, early=True)
        # try again once the frames it asked for are there; where no edge was found, at twice the age
        asked = np.minimum(found.columns[:, ASKED], frames)
        asked = np.maximum(search_window(start, frames)[0] + asked.astype(np.int64), frames) + LATER
        due = np.where(np.isfinite(found.columns[:, ASKED]), asked, 2 * frames - start)
        self._due[pixels] = np.minimum(due, np.iinfo(np.int32).max)
        # as many as there is room for: the others are estimated at the end
        good = np.flatnonzero((found.outcome == FITTED) | (found.outcome == LOCAL))[: len(self._start) - self.kept]
        rows = np.arange(self.kept, self.kept + len(good))
        self._entry[pixels[good]] = rows
        self._pixel[rows], self._start[rows] = pixels[good], start[good]
        for column, part in zip(self._table, found, strict=True):
            column[rows] = part[good]
        self.kept += len(good)

    def _follow(self, sequence: FrameSequence, weighting: EdgeWeighting, rows: I8) -> None:
        found = self._table.take(rows)
        follow_pixels(sequence, weighting, self._pixel[rows], self._start[rows], found)
        self._table.columns[rows], self._table.seen[rows] = found.columns, found.seen

    def known(self, pixels: I8, start: I8, extent: NDArray[np.float64]) -> EdgeEstimates:
        """Stored estimates of pixels [p] that hold for this first crossing [p] and range [p]; else NOTHING."""
        found = EdgeEstimates.empty(len(pixels))
        entry = self._entry[pixels]
        # a brighter light later in the sweep raises S: the first crossing may have moved, or the range grown
        held = np.flatnonzero(entry >= 0)
        rows = entry[held]
        same = (self._start[rows] == start[held]) & (extent[held] <= self._table.columns[rows, MOST_EXTENT])
        held, rows = held[same], rows[same]
        for column, part in zip(self._table, found, strict=True):
            part[held] = column[rows]
        return found
