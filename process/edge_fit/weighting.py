"""What weights the samples in the edge fits of a scan: its noise, and the width of its sharp edges.

Both are found as soon as the sweep has shown enough edges, as a function of the frames until then alone. So an estimate
made during the sweep and one made from the whole file have the same weights. Places are numbers of frames among the
folded ones; widths in frames; noise in levels of the stored depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from process.crossings.maps import Edge, full_scale, level_step
from process.edge_fit.noise_model import PAIRS, NoiseModel, guard_frames, model_from, noise_figures
from process.edge_fit.pixel_columns import ReadColumns
from process.edge_fit.pixel_kernels import FAR, count_sharp
from process.numba_cache import kernel

GRID_PIXELS = 16_000
"""Pixels, spread over the image, that are read until the noise is known."""
STEP = 32
"""Frames read at a time."""
EARLIEST = 128
"""Frames before the first measurement."""
GUARD = 24
"""Least frames to each side of a crossing that are left out of it."""
ENOUGH = 150
"""Pixels that have to have been bright for a while before the noise is measured."""
LEAST_COUNTS = 20
"""Least range, in counts of 8 bit, of a pixel that the light has passed."""
STEP_PIXELS = 1000
"""Pixels in which the step between two levels is looked for."""
SHARP_PIXELS = 3000
"""Pixels whose edges are counted for the width of the sharp ones."""
SAMPLES_PER_WIDTH = 2.5631
"""Length of the interval from 10 to 90 % of an erf edge, in widths (standard deviations)."""
USUAL_SHARP_WIDTH = 0.5
"""In frames; taken where a scan has too few sharp edges."""


@dataclass(frozen=True)
class FrameSequence:
    """The folded frames of a scan, or the first of them, for reading single pixels."""

    columns: ReadColumns
    present: NDArray[np.int64]
    """Frame index of each folded frame, ascending."""
    edge: Edge
    bit_depth: int

    @cached_property
    def times(self) -> NDArray[np.float64]:
        """``present`` as float64."""
        return self.present.astype(np.float64)

    @property
    def full(self) -> int:
        """Full scale where the complement is folded (falling edges), else 0."""
        return full_scale(self.bit_depth) if self.edge == "falling" else 0


class EdgeWeighting(NamedTuple):
    """Noise and sharp width of a scan."""

    noise: NoiseModel
    """Of the folded signal, in levels of the stored depth."""
    sharp_width: float
    """Width of the sharp edges, in frames."""

    def noise_coefficients(self, sequence: FrameSequence) -> NDArray[np.float64]:
        """[6] for the kernels: floor and slope of the variance, lower and upper clipping level, step, count."""
        # the highest level that occurs at all: a camera of 12 bit, left-aligned in 16, ends at 65520
        clipped = self.noise.step - 1.0
        lowest, highest = (clipped, np.inf) if sequence.full else (-np.inf, full_scale(sequence.bit_depth) - clipped)
        count = 2.0 ** (sequence.bit_depth - 8)
        return np.array([self.noise.floor, self.noise.slope, lowest, highest, self.noise.step, count])


@kernel
def first_at_half(rows, full, least, start):
    """start [pixels]: place of the first level at or above half of a pixel's range, rows [pixels, frames]; -1 where the
    range is below `least` or the first level is above already. full: see FrameSequence.full."""
    for i in range(rows.shape[0]):
        low, high = np.int64(rows[i].min()), np.int64(rows[i].max())
        start[i] = -1
        if high - low < least or (2 * np.int64(rows[i, 0]) >= low + high) != (full > 0):
            continue
        # levels of a falling edge are compared from above, without making the complement
        for k in range(1, rows.shape[1]):
            twice = 2 * np.int64(rows[i, k])
            if (full > 0 and twice <= low + high) or (full == 0 and twice >= low + high):
                start[i] = k
                break


def noise_of(
    sequence: FrameSequence, pixels: NDArray[np.int64], start: NDArray[np.int64], fallback: NoiseModel, guard: int = 0
) -> NoiseModel:
    """Noise from the plateaus to both sides of a first crossing; start [pixels]: its place, -1 for none.

    guard: least number of frames to each side of it that are left out.
    """
    frames = len(sequence.present)
    guard = max(guard, guard_frames(frames))
    dark_end = np.where(start >= 0, start - guard, frames // 2)
    bright_begin = np.where(start >= 0, start + guard, frames // 2)
    # without a crossing the whole sequence is flat: half of it stands for either plateau
    dark_pairs = np.clip(dark_end // 2, 0, PAIRS)
    bright_pairs = np.clip((frames - bright_begin) // 2, 0, PAIRS)
    bright_begin = np.minimum(bright_begin, frames)
    return model_from(
        np.concatenate(
            [
                _figures(sequence, pixels, dark_end - 2 * dark_pairs, dark_pairs),
                _figures(sequence, pixels, bright_begin, bright_pairs),
            ]
        ),
        full_scale(sequence.bit_depth),
        replace(fallback, step=step_of(sequence, pixels)),
    )


def step_of(sequence: FrameSequence, pixels: NDArray[np.int64]) -> float:
    """``level_step`` of some pixels; 1 in 8 bit."""
    if sequence.bit_depth == 8:
        return 1.0
    seen = np.zeros(full_scale(sequence.bit_depth) + 1, np.bool_)
    some = pixels[:: max(1, -(-len(pixels) // STEP_PIXELS))]
    for place in range(0, len(sequence.present), STEP):
        first = np.full(len(some), place)
        seen[sequence.columns(some, first, np.minimum(first + STEP, len(sequence.present)))] = True
    return level_step(seen)


def _figures(
    sequence: FrameSequence, pixels: NDArray[np.int64], begin: NDArray[np.int64], pairs: NDArray[np.int64]
) -> NDArray[np.float64]:
    some = np.flatnonzero(pairs > 0)
    found = np.empty((len(some), 2))
    if not len(some):
        return found
    rows = sequence.columns(pixels[some], begin[some], begin[some] + 2 * pairs[some])
    top = full_scale(sequence.bit_depth)
    return found[: noise_figures(rows, pairs[some], top, sequence.edge == "falling", found)]


def sharp_width_of(
    sequence: FrameSequence, pixels: NDArray[np.int64], start: NDArray[np.int64], noise: NoiseModel
) -> float:
    """Width in frames of the sharp edges, from the number of samples within them; else USUAL_SHARP_WIDTH."""
    known = np.flatnonzero(start >= 0)
    known = known[:: max(1, -(-len(known) // SHARP_PIXELS))]  # evenly chosen, rounded up
    if not len(known):
        return USUAL_SHARP_WIDTH
    first = np.maximum(start[known] - FAR, 0)
    end = np.minimum(start[known] + FAR, len(sequence.present))
    rows = sequence.columns(pixels[known], first, end)
    within, edges = count_sharp(rows, sequence.full, first, end, start[known], noise.coefficients())
    return float(np.clip(within / (SAMPLES_PER_WIDTH * edges), 0.2, 1.0)) if edges >= 50 else USUAL_SHARP_WIDTH


class WeightingFinder:
    """Reads pixels spread over the image, as frames arrive, until they tell the weighting of the scan."""

    def __init__(self, shape: tuple[int, int], fallback: NoiseModel) -> None:
        self._fallback = fallback
        self._place = 0
        self._measure_at = EARLIEST
        self._pixels = grid(shape)
        self._low: NDArray[np.int64] = np.full(len(self._pixels), 1 << 30)
        self._high = -self._low
        self._earlier = [self._high] * 3
        self.weighting: EdgeWeighting | None = None
        """None until it is known."""

    def advance(self, sequence: FrameSequence, steps: int) -> bool:
        """Read up to ``steps`` further groups of STEP frames of ``sequence``; True if there was one to read."""
        for taken in range(steps):
            if self.weighting is not None or self._place + STEP > len(sequence.present):
                return taken > 0
            self._take(sequence)
        return True

    def _take(self, sequence: FrameSequence) -> None:
        first = np.full(len(self._pixels), self._place)
        self._place += STEP
        levels = sequence.columns(self._pixels, first, first + STEP).astype(np.int64)
        if sequence.full:
            levels = sequence.full - levels
        self._low = np.minimum(self._low, levels.min(axis=1))
        self._high = np.maximum(self._high, levels.max(axis=1))
        # bright for three groups of frames: close to the final level, and before the newest readings
        long_bright = self._earlier.pop(0) - self._low >= 0.8 * (self._high - self._low)
        self._earlier.append(self._high)
        passed = self._high - self._low >= LEAST_COUNTS << (sequence.bit_depth - 8)
        if self._place >= self._measure_at and np.count_nonzero(long_bright & passed) >= min(ENOUGH, len(passed) // 8):
            self._measure(sequence)
            # if that was not enough, the next attempt comes much later: each reads all frames so far
            self._measure_at = self._place * 3 // 2

    def _measure(self, sequence: FrameSequence) -> None:
        until = FrameSequence(sequence.columns, sequence.present[: self._place], sequence.edge, sequence.bit_depth)
        zeros = np.zeros(len(self._pixels), np.int64)
        rows = until.columns(self._pixels, zeros, zeros + self._place)
        start = np.empty(len(rows), np.int64)
        first_at_half(rows, until.full, LEAST_COUNTS << (until.bit_depth - 8), start)
        noise = noise_of(until, self._pixels, start, self._fallback, GUARD)
        if noise.measured:
            self.weighting = EdgeWeighting(noise, sharp_width_of(until, self._pixels, start, noise))


def grid(shape: tuple[int, int], pixels: int = GRID_PIXELS) -> NDArray[np.int64]:
    """Flat indices of about so many pixels, evenly spread over the image [h, w]."""
    step = max(1, int((shape[0] * shape[1] / pixels) ** 0.5))
    rows, columns = np.arange(step // 2, shape[0], step), np.arange(step // 2, shape[1], step)
    return np.asarray((rows[:, None] * shape[1] + columns).ravel(), np.int64)
