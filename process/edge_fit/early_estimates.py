"""Owns the estimates made while a sweep runs, of pixels whose edge has passed: that much less is left to its end.

Promises nothing but time: an estimate is kept only where no later frame can change it, and only its pixel's own
frames, the first of them at half brightness and the weighing enter it. Without any of them the result is the same.
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
    examine_rows,
    follow_rows,
)
from process.edge_fit.weighting import Sequence, Watch, Weighing

AT_ONCE = 256
"""Pixels examined in one go: a few milliseconds."""
FOLLOWED_AT_ONCE = 4096
"""Pixels whose light is followed in one go, likewise."""
FIRST_AGE = 16
"""Frames after a crossing when its pixel is first examined."""
LATER = 4
"""Frames that are waited for beyond those that an edge asked for: with more of it, it may ask for more."""
STALE = 16
"""Frames that may follow before the light of a pixel is followed on."""
TABLE_BYTES = 96_000_000
"""Most bytes of estimates kept; the rest of a scan's are made at its end."""

I8 = NDArray[np.int64]


class Found(NamedTuple):
    """Estimates of pixels, [p] and [p, COLUMNS] of ``block_kernels``."""

    outcome: I8
    columns: NDArray[np.float64]
    seen: I8
    """Place up to which the light was followed; 0 where the outcome is NOTHING."""

    @classmethod
    def none(cls, pixels: int) -> Found:
        """Nothing known."""
        return cls(np.full(pixels, NOTHING), np.zeros((pixels, COLUMNS)), np.zeros(pixels, np.int64))

    def of(self, some: I8) -> Found:
        """A copy of some of them."""
        return Found(self.outcome[some], self.columns[some], self.seen[some])


def stretch_of(start: I8, frames: int) -> tuple[I8, I8]:
    """First and end place of what is looked at about a first crossing."""
    return np.maximum(start - FAR, 0), np.minimum(start + FAR, frames)


def examine_pixels(
    sequence: Sequence,
    weighing: Weighing,
    pixels: I8,
    start: I8,
    extent: NDArray[np.float64],
    *,
    local: bool,
    early: bool = False,
) -> Found:
    """Examine the edges of some pixels anew (``block_kernels.examine_rows``)."""
    found = Found.none(len(pixels))
    if not len(pixels):
        return found
    first, end = stretch_of(start, len(sequence.present))
    rows = sequence.columns(pixels, first, end)
    told = (weighing.told(sequence), weighing.sharp_width, local, early)
    examine_rows(rows, sequence.full, sequence.times, first, end, start, extent, *told, found.outcome, found.columns)
    found.seen[:] = end
    return found


def follow_pixels(sequence: Sequence, weighing: Weighing, pixels: I8, start: I8, found: Found) -> None:
    """Follow the light of pixels that are known already to the end of their stretch; changes ``found``."""
    _, end = stretch_of(start, len(sequence.present))
    some = np.flatnonzero((found.seen < end) & (found.outcome == FITTED))
    if not len(some):
        return
    first, end, outcome, columns = found.seen[some], end[some], found.outcome[some], found.columns[some]
    rows = sequence.columns(pixels[some], first, end)
    follow_rows(rows, sequence.full, sequence.times, first, end, weighing.told(sequence), outcome, columns)
    found.columns[some], found.seen[some] = columns, end


class EarlyEstimates:
    """Estimates of one sweep. One thread at a time."""

    def __init__(self, shape: tuple[int, int], fallback: NoiseModel, *, local: bool) -> None:
        """shape: (height, width). local: as in ``block_kernels.examine``."""
        self.watch = Watch(shape, fallback)
        self._local = local
        pixels = shape[0] * shape[1]
        self._entry: NDArray[np.int32] = np.full(pixels, -1, np.int32)
        """Row of the table that holds a pixel's estimate; -1 where there is none."""
        self._due: NDArray[np.int32] = np.zeros(pixels, np.int32)
        """Number of folded frames from which on it is worth a try."""
        room = min(pixels, TABLE_BYTES // (8 * COLUMNS + 32))
        self._pixel, self._start = np.empty(room, np.int64), np.empty(room, np.int64)
        self._table = Found.none(room)
        self.kept = 0
        """Rows of the table in use."""
        self._queue: list[tuple[I8, I8, NDArray[np.float64]]] = []
        self._stale: list[I8] = []

    @staticmethod
    def bytes_needed(shape: tuple[int, int]) -> int:
        """Memory in bytes at most."""
        return shape[0] * shape[1] * 8 + min(TABLE_BYTES, shape[0] * shape[1] * (8 * COLUMNS + 32))

    @property
    def busy(self) -> bool:
        """There is something to be done."""
        return self.watch.weighing is not None and bool(self._queue or self._stale)

    def propose(self, maps: Maps, start: I8, folded: int) -> None:
        """Queue the pixels of ``maps`` that are old enough; start [h * w]: place of their first crossing, -1 none."""
        wanted = np.flatnonzero((start >= 0) & (start + FIRST_AGE <= folded) & (self._due <= folded))
        entry = self._entry[wanted]
        wanted = wanted[(entry < 0) | (self._start[entry] != start[wanted])]
        extent = maps.maximum.ravel()[wanted].astype(np.float64) - maps.minimum.ravel()[wanted]
        cuts = range(AT_ONCE, len(wanted), AT_ONCE)
        parts = (np.split(array, cuts) for array in (wanted, start[wanted], extent))
        self._queue = list(zip(*parts, strict=True)) if len(wanted) else []
        _, end = stretch_of(self._start[: self.kept], folded)
        unseen = end - self._table.seen[: self.kept]
        stale = np.flatnonzero((unseen >= STALE) & (self._table.outcome[: self.kept] == FITTED))
        self._stale = np.split(stale, range(FOLLOWED_AT_ONCE, len(stale), FOLLOWED_AT_ONCE)) if len(stale) else []

    def work(self, sequence: Sequence) -> None:
        """Do some of what waits, in the frames of ``sequence``, all of which are in the file for good."""
        weighing = self.watch.weighing
        if weighing is None:
            return
        if self._queue:
            self._examine(sequence, weighing, *self._queue.pop())
        elif self._stale:
            self._follow(sequence, weighing, self._stale.pop())

    def _examine(
        self, sequence: Sequence, weighing: Weighing, pixels: I8, start: I8, extent: NDArray[np.float64]
    ) -> None:
        frames = len(sequence.present)
        there = start < frames
        pixels, start, extent = pixels[there], start[there], extent[there]
        found = examine_pixels(sequence, weighing, pixels, start, extent, local=self._local, early=True)
        # once as many frames are there as it asked for; where there was no edge to be seen, at twice its age
        asked = np.minimum(found.columns[:, ASKED], frames)
        asked = np.maximum(stretch_of(start, frames)[0] + asked.astype(np.int64), frames) + LATER
        due = np.where(np.isfinite(found.columns[:, ASKED]), asked, 2 * frames - start)
        self._due[pixels] = np.minimum(due, np.iinfo(np.int32).max)
        good = np.flatnonzero((found.outcome == FITTED) | (found.outcome == LOCAL))[: len(self._start) - self.kept]
        rows = np.arange(self.kept, self.kept + len(good))
        self._entry[pixels[good]] = rows
        self._pixel[rows], self._start[rows] = pixels[good], start[good]
        for column, part in zip(self._table, found, strict=True):
            column[rows] = part[good]
        self.kept += len(good)

    def _follow(self, sequence: Sequence, weighing: Weighing, rows: I8) -> None:
        found = self._table.of(rows)
        follow_pixels(sequence, weighing, self._pixel[rows], self._start[rows], found)
        self._table.columns[rows], self._table.seen[rows] = found.columns, found.seen

    def known(self, pixels: I8, start: I8, extent: NDArray[np.float64]) -> Found:
        """What is known of pixels whose first crossing is at ``start`` and whose range is ``extent``."""
        found = Found.none(len(pixels))
        entry = self._entry[pixels]
        held = np.flatnonzero(entry >= 0)
        rows = entry[held]
        same = (self._start[rows] == start[held]) & (extent[held] <= self._table.columns[rows, MOST_EXTENT])
        held, rows = held[same], rows[same]
        for column, part in zip(self._table, found, strict=True):
            part[held] = column[rows]
        return found
