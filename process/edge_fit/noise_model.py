"""Noise model of a scan: variance against level, measured in its own frames where the light does not change.

Variance in levels squared of the stored depth, at least that of rounding (step^2 / 12) at every level of the scale.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from process.numba_cache import kernel

ROUNDING_VARIANCE = 1.0 / 12.0
PAIRS = 16
"""Pairs of neighbouring frames whose differences give one variance; fewer where the plateau is short."""
LEAST_PAIRS = 6
LEAST_FIGURES = 50
"""Fewer variances than this do not represent a scan."""
BINS = 12


@dataclass(frozen=True)
class NoiseModel:
    """Variance = floor + slope x level, of the folded signal, in levels squared."""

    floor: float
    slope: float
    measured: bool
    """False: taken from the configuration, because the frames do not tell."""
    step: float = 1.0
    """Levels from one that occurs to the next; rounding to them has a variance of step^2 / 12."""

    def coefficients(self) -> NDArray[np.float64]:
        """[2] floor and slope, for kernels."""
        return np.array([self.floor, self.slope])

    def sigma_at(self, level: float) -> float:
        """Standard deviation at a level, in levels."""
        return math.sqrt(max(self.floor + self.slope * level, ROUNDING_VARIANCE))


def assumed_noise(noise_levels: float) -> NoiseModel:
    """The same noise at every level: the configured standard deviation in levels, and rounding."""
    return NoiseModel(noise_levels**2 + ROUNDING_VARIANCE, 0.0, measured=False)


@kernel
def noise_figures(rows, pairs, top, falling, figures):
    """Fill figures [:, 2] (mean level, variance) from rows [n, 2 x PAIRS] of levels; returns their number.

    pairs [n]: pairs of neighbouring frames in each row. A row with too few pairs, or with a value at an end of the
    scale (0 or top), is left out. falling: the levels are those of the complement.
    """
    count = 0
    for i in range(rows.shape[0]):
        total, squares, inside = 0.0, 0.0, pairs[i] >= LEAST_PAIRS
        for pair in range(pairs[i] if inside else 0):
            one, other = float(rows[i, 2 * pair]), float(rows[i, 2 * pair + 1])
            if min(one, other) <= 0 or max(one, other) >= top:
                inside = False
                break
            # differences of neighbours: slow changes of the lamp cancel
            total += one + other
            squares += (one - other) * (one - other)
        if inside:
            level = total / (2 * pairs[i])
            figures[count, 0] = top - level if falling else level
            # a variance of few pairs is chi squared distributed: by Wilson and Hilferty this makes its median the
            # variance
            figures[count, 1] = squares / (2 * pairs[i]) / (1.0 - 2.0 / (9.0 * pairs[i])) ** 3
            count += 1
    return count


def guard_frames(frames: int) -> int:
    """Frames left out to each side of a crossing: more than an edge is wide, if the scan is long enough."""
    return min(40, max(8, frames // 8))


def model_from(found: NDArray[np.float64], full: int, fallback: NoiseModel) -> NoiseModel:
    """Line through the medians of the figures [n, 2], binned by level; ``fallback`` where they are too few.

    The variance is nowhere below that of rounding to the step of ``fallback``.
    """
    rounding = ROUNDING_VARIANCE * fallback.step**2
    if len(found) < LEAST_FIGURES:
        return fallback
    order = np.argsort(found[:, 0], kind="stable")
    parts = np.array_split(found[order], BINS)
    level = np.array([np.median(part[:, 0]) for part in parts])
    variance = np.maximum([np.median(part[:, 1]) for part in parts], rounding)
    if level[-1] - level[0] < 0.05 * full:
        return NoiseModel(float(np.mean(variance)), 0.0, measured=True, step=fallback.step)
    floor, slope = _line(level, variance)
    least = min(floor, floor + slope * full)
    if least < rounding:  # turn the line about its middle until it is possible at both ends
        middle = float(np.median(level))
        pivot = floor + slope * middle
        reach = middle if floor < floor + slope * full else full - middle
        steep = max(pivot - rounding, 0.0) / max(reach, 1.0)
        slope = math.copysign(min(abs(slope), steep), slope)
        floor = pivot - slope * middle
    return NoiseModel(float(floor), float(slope), measured=True, step=fallback.step)


def _line(level: NDArray[Any], variance: NDArray[Any]) -> tuple[float, float]:
    """(floor, slope) by least squares of relative residuals: the scatter of a variance is proportional to it."""
    design = np.stack([np.ones_like(level), level], axis=1) / variance[:, None]
    (floor, slope), *_ = np.linalg.lstsq(design, np.ones_like(level), rcond=None)
    return float(floor), float(slope)
