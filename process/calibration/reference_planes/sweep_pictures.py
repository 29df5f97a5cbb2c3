"""What the pictures of a sweep tell of the regions: plateaus of pixels, gain of frames, direction of the motion.

Levels are float32 in counts of the stored depth. Half brightness is 0, between -0.5 (dark) and 0.5 (lit).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from process.calibration.light_plane import robust
from process.fold.fold import to_grey
from process.results.scan_frames import ScanFrames

from .known_planes import ReferencePlane

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Progress = Callable[[int, int], None]
"""Called with (pictures read, pictures to read)."""
PLATEAU = 0.25
"""Levels further from the middle than this share of the contrast belong to a plateau."""
MIN_LIT = 0.2
"""The gain of a frame is measured where at least this share of the pixels is lit."""


@dataclass(frozen=True)
class Region:
    """A plane's part of the pictures, [h, w]."""

    plane: ReferencePlane
    low: F4
    high: F4
    usable: NDArray[np.bool_]
    """Pixels with enough contrast."""
    motion: F8
    """[2] unit vector in the picture along which the edge travels; zeros where nothing crosses."""

    @property
    def origin(self) -> F8:
        """[2] pixel x, y of its first pixel."""
        return np.array([self.plane.region[0], self.plane.region[2]], dtype=np.float64)

    def shares(self, picture: F4) -> F4:
        """Normalised picture: -0.5 dark to 0.5 lit."""
        return np.asarray((picture - self.low) / np.maximum(self.high - self.low, 1.0) - 0.5, dtype=np.float32)


@dataclass(frozen=True)
class SweepPictures:
    """The regions of both planes, and how to read their pictures again."""

    scan: Path
    regions: tuple[Region, ...]
    gain: F8
    """[frames] brightness of the lit pixels relative to the sweep's; NaN where there is no picture."""

    @property
    def frames(self) -> int:
        """Frames of the sweep."""
        return len(self.gain)

    def pictures(self, progress: Progress | None = None) -> Iterator[tuple[int, list[F4]]]:
        """Index and regions of each frame, its gain taken out."""
        for index, parts in _pictures(self.scan, [r.plane for r in self.regions], progress):
            yield index, [part / np.float32(self.gain[index]) for part in parts]


def _pictures(
    scan: Path, planes: Sequence[ReferencePlane], progress: Progress | None = None
) -> Iterator[tuple[int, list[F4]]]:
    with ScanFrames(scan) as frames:
        present, crc = np.flatnonzero(frames.present()), frames.field("crc32")
        for count, index in enumerate(present.tolist()):
            pixels = frames.pixels(index, int(crc[index]))
            if progress is not None:
                progress(count + 1, len(present))
            if pixels is None:
                continue
            grey = to_grey(pixels, frames.layout.format.bit_depth)
            cuts = [plane.region for plane in planes]
            yield index, [grey[t : b + 1, le : r + 1].astype(np.float32) for le, r, t, b in cuts]


def read_sweep(
    scan: Path, planes: Sequence[ReferencePlane], *, edge: str, contrast: int, progress: Progress | None = None
) -> SweepPictures:
    """Plateaus, gains and directions of motion of a sweep, in three passes over its pictures.

    Args:
        scan: folder or .h5.
        planes: whose regions are read.
        edge: rising or falling.
        contrast: least range between both plateaus, counts of 8 bit.
        progress: of the passes.

    Raises:
        ScanFileError: no readable scan.
    """
    with ScanFrames(scan) as frames:
        count, depth = frames.layout.count, frames.layout.format.bit_depth
    passes = _Passes(progress)
    least = contrast * 2.0 ** (depth - 8)
    extremes = _extremes(_pictures(scan, planes, passes.step()))
    gain = np.full(count, np.nan)
    for index, parts in _pictures(scan, planes, passes.step()):
        gain[index] = _gain(parts, extremes)
    means = [_Plateaus(low, high, edge) for low, high in extremes]
    for index, parts in _pictures(scan, planes, passes.step()):
        for mean, part in zip(means, parts, strict=True):
            mean.add(index, part / np.float32(gain[index]))
    return SweepPictures(
        scan, tuple(mean.region(plane, least) for mean, plane in zip(means, planes, strict=True)), gain
    )


class _Passes:
    """Progress over the passes that are made; the fourth finds the lines."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress, self._done = progress, 0

    def step(self) -> Progress | None:
        progress, done = self._progress, self._done
        self._done += 1
        if progress is None:
            return None
        return lambda read, of: progress(done * of + read, PASSES * of)


PASSES = 4
"""Times that the pictures are read, the search for lines included."""


def _extremes(pictures: Iterator[tuple[int, list[F4]]]) -> list[tuple[F4, F4]]:
    found: list[tuple[F4, F4]] = []
    for _, parts in pictures:
        if not found:
            found = [(part.copy(), part.copy()) for part in parts]
        for (low, high), part in zip(found, parts, strict=True):
            np.minimum(low, part, out=low)
            np.maximum(high, part, out=high)
    return found


def _gain(parts: list[F4], extremes: list[tuple[F4, F4]]) -> float:
    """Median of level / maximum of the lit pixels: below 1 where the camera exposed less; 1 where few are lit."""
    ratios = []
    for part, (low, high) in zip(parts, extremes, strict=True):
        lit = (part > low + (0.5 + PLATEAU) * (high - low)) & (high > 1.5 * low + 8)
        ratios.append(part[lit] / high[lit])
    total = np.concatenate(ratios)
    if total.size < MIN_LIT * sum(part.size for part in parts):
        return 1.0
    return float(np.median(total[:: max(total.size // 20_000, 1)]))


class _Plateaus:
    """Means of the dark and of the lit levels of each pixel, and when it crosses first."""

    def __init__(self, low: F4, high: F4, edge: str) -> None:
        self._middle, self._far = (low + high) / 2, PLATEAU * (high - low)
        self._dark, self._lit = np.zeros_like(low), np.zeros_like(low)
        self._dark_count, self._lit_count = np.zeros_like(low), np.zeros_like(low)
        self._ready = np.zeros(low.shape, np.bool_)
        self._arrival = np.full(low.shape, np.nan, np.float32)
        self._falling = edge == "falling"

    def add(self, index: int, part: F4) -> None:
        lit, dark = part > self._middle + self._far, part < self._middle - self._far
        self._lit += np.where(lit, part, 0)
        self._dark += np.where(dark, part, 0)
        self._lit_count += lit
        self._dark_count += dark
        before, after = (lit, dark) if self._falling else (dark, lit)
        self._arrival[self._ready & after & np.isnan(self._arrival)] = index
        self._ready |= before

    def region(self, plane: ReferencePlane, least: float) -> Region:
        low = self._dark / np.maximum(self._dark_count, 1)
        high = self._lit / np.maximum(self._lit_count, 1)
        usable = (self._dark_count > 0) & (self._lit_count > 0) & (self._far >= PLATEAU * least)
        return Region(plane, low.astype(np.float32), high.astype(np.float32), usable, self._motion(usable))

    def _motion(self, usable: NDArray[np.bool_]) -> F8:
        """Direction in which the arrival increases, by a robust plane through it."""
        row, column = np.nonzero(usable & np.isfinite(self._arrival))
        if len(row) < 50:
            return np.zeros(2)
        some = np.random.default_rng(1).permutation(len(row))[:4000]
        row, column = row[some], column[some]
        design = np.column_stack([column, row, np.ones(len(row))]).astype(np.float64)
        slope = robust.solve(design, self._arrival[row, column].astype(np.float64), seed=1).x[:2]
        length = float(np.linalg.norm(slope))
        return slope / length if length > 0 else np.zeros(2)
