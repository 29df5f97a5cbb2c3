"""Owns the noise model of a scan: variance against level, measured from its own frames where nothing moves.

Promises a variance of at least the rounding's, 1/12 level squared, at every level of the scale.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from process.compiled import kernel

ROUNDING_VARIANCE = 1.0 / 12.0
PAIRS = 16
"""Pairs of neighbouring frames whose differences make one figure; fewer where the plateau is short."""
LEAST_PAIRS = 6
LEAST_FIGURES = 50
"""Fewer figures than this say nothing about a whole scan."""
BINS = 12


@dataclass(frozen=True)
class NoiseModel:
    """Variance = floor + slope x level, of the folded signal, in levels squared."""

    floor: float
    slope: float
    measured: bool
    """False: taken from the configuration, because the frames did not tell."""

    def coefficients(self) -> NDArray[np.float64]:
        """[2] floor and slope, for kernels."""
        return np.array([self.floor, self.slope])

    def sigma_at(self, level: float) -> float:
        """Standard deviation at a level, in levels."""
        return math.sqrt(max(self.floor + self.slope * level, ROUNDING_VARIANCE))


def assumed_noise(noise_levels: float) -> NoiseModel:
    """The same noise at every level: read noise of the configuration, and rounding."""
    return NoiseModel(noise_levels**2 + ROUNDING_VARIANCE, 0.0, measured=False)


@kernel
def _figure(column, begin, pairs, full, figures, row):
    # mean level and variance from the differences of disjoint pairs of frames: slow changes cancel
    total, squares = 0.0, 0.0
    for pair in range(pairs):
        one, other = float(column[begin + 2 * pair]), float(column[begin + 2 * pair + 1])
        if min(one, other) <= 0 or max(one, other) >= full:
            return row
        total += one + other
        squares += (one - other) * (one - other)
    figures[row, 0] = total / (2 * pairs)
    figures[row, 1] = squares / (2 * pairs) / (1.0 - 2.0 / (9.0 * pairs)) ** 3
    return row + 1


@kernel
def noise_figures(columns, start, guard, stride, full, figures):
    """Fill figures [:, 2] (level, variance) from the plateaus of every stride-th pixel; returns how many there are.

    columns [frames, pixels], folded signal; start [pixels]: ordinal of the crossing, -1 where there is none;
    guard: frames to each side of it that do not count. A variance is corrected so that the median over many is
    that of the noise; a figure with a value at an end of the scale is left out.
    """
    frames, pixels = columns.shape
    row = 0
    for pixel in range(0, pixels, stride):
        if row + 2 > figures.shape[0]:
            break
        column = columns[:, pixel]
        dark_end = start[pixel] - guard if start[pixel] >= 0 else frames // 2
        bright_begin = start[pixel] + guard if start[pixel] >= 0 else frames // 2
        pairs = min(PAIRS, dark_end // 2)
        if pairs >= LEAST_PAIRS:
            row = _figure(column, dark_end - 2 * pairs, pairs, full, figures, row)
        pairs = min(PAIRS, (frames - bright_begin) // 2)
        if pairs >= LEAST_PAIRS:
            row = _figure(column, bright_begin, pairs, full, figures, row)
    return row


def guard_frames(frames: int) -> int:
    """Frames about a crossing that are kept out of the noise: more than an edge is wide, if the scan is long enough."""
    return min(40, max(8, frames // 8))


def model_from(figures: Iterable[NDArray[np.float64]], full: int, fallback: NoiseModel) -> NoiseModel:
    """The line through the medians of the figures [n, 2] by level; ``fallback`` where they are too few."""
    found = np.concatenate([np.empty((0, 2)), *figures])
    if len(found) < LEAST_FIGURES:
        return fallback
    order = np.argsort(found[:, 0], kind="stable")
    parts = np.array_split(found[order], BINS)
    level = np.array([np.median(part[:, 0]) for part in parts])
    variance = np.maximum([np.median(part[:, 1]) for part in parts], ROUNDING_VARIANCE)
    if level[-1] - level[0] < 0.05 * full:
        return NoiseModel(float(np.mean(variance)), 0.0, measured=True)
    floor, slope = _line(level, variance)
    least = min(floor, floor + slope * full)
    if least < ROUNDING_VARIANCE:  # turn the line about its middle until it is possible at both ends
        middle = float(np.median(level))
        pivot = floor + slope * middle
        reach = middle if floor < floor + slope * full else full - middle
        steep = max(pivot - ROUNDING_VARIANCE, 0.0) / max(reach, 1.0)
        slope = math.copysign(min(abs(slope), steep), slope)
        floor = pivot - slope * middle
    return NoiseModel(float(floor), float(slope), measured=True)


def _line(level: NDArray[Any], variance: NDArray[Any]) -> tuple[float, float]:
    """Least squares of relative residuals: the scatter of a variance is proportional to it."""
    design = np.stack([np.ones_like(level), level], axis=1) / variance[:, None]
    (floor, slope), *_ = np.linalg.lstsq(design, np.ones_like(level), rcond=None)
    return float(floor), float(slope)
