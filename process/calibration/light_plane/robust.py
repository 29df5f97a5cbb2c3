"""Robust linear least squares: a random start that holds against 40 % of outliers, then Tukey's weights.

The start is that of least median of squares: of many solutions of a few rows, the one with the least median residual.
Then iterated least squares with Tukey's biweight, whose outliers have weight 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]
DRAWS = 400
DRAW_ROWS = 8
FEW = 4000
"""Rows by which the random solutions are judged."""
TUKEY = 4.685
"""Cut-off of the biweight in standard deviations: 95 % efficiency for normal errors."""
MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation of a normal variable."""
ROUNDS = 30


def median_and_scale(values: F8) -> tuple[float, float]:
    """Median of values [n], and their standard deviation from the median absolute deviation."""
    middle = float(np.median(values))
    return middle, MAD_TO_SIGMA * float(np.median(np.abs(values - middle)))


class RobustFit(NamedTuple):
    """A robust fit of design @ x = values."""

    x: F8
    """[k]."""
    covariance: F8
    """[k, k], for independent errors."""
    weight: F8
    """[n] 0..1: Tukey's; 0 is an outlier."""
    scale: float
    """Robust standard deviation of a residual of unit prior weight."""


def solve(
    design: F8, values: F8, sigma: F8 | None = None, seed: int = 0, start: F8 | None = None, rounds: int = ROUNDS
) -> RobustFit:
    """Solve design [n, k] @ x = values [n] robustly; ``sigma`` [n]: relative standard deviations of the values.

    With ``start`` [k], near the solution, no random start is made: quicker, but no defence against many outliers.
    """
    prior = np.ones(len(values)) if sigma is None else 1.0 / sigma
    rows, right = design * prior[:, None], values * prior
    # columns of size 1: mm, px and t may differ by orders of magnitude
    unit = np.sqrt((rows**2).mean(axis=0))
    rows = rows / unit
    x = _start(rows, right, np.random.default_rng(seed)) if start is None else np.asarray(start) * unit
    weight, scale = np.ones(len(values)), 1.0
    for _ in range(rounds):
        residual = right - rows @ x
        scale = max(MAD_TO_SIGMA * float(np.median(np.abs(residual))), 1e-12)
        weight = np.clip(1 - (residual / (TUKEY * scale)) ** 2, 0, None) ** 2
        root = np.sqrt(weight)
        moved = np.linalg.lstsq(rows * root[:, None], right * root, rcond=None)[0]
        done = np.abs(moved - x).max() < 1e-10 * max(float(np.abs(moved).max()), 1e-300)
        x = moved
        if done:
            break
    residual = right - rows @ x
    inner = rows.T @ (rows * weight[:, None])
    variance = float((weight * residual**2).sum() / max(weight.sum() - len(x), 1))
    covariance = variance * np.linalg.pinv(inner) / np.outer(unit, unit)
    return RobustFit(x / unit, covariance, weight, scale)


def _start(rows: F8, right: F8, generator: np.random.Generator) -> F8:
    """The random solution with the least median residual, then least squares of its better half of the rows."""
    chosen = generator.permutation(len(rows))[:FEW]
    some, some_right = rows[chosen], right[chosen]
    # few rows: with 40 % of outliers 1.7 % of the draws of 8 rows hold none, some 7 of 400
    size = min(max(DRAW_ROWS, rows.shape[1] + 1), len(some))
    best, least = np.zeros(rows.shape[1]), np.inf
    for _ in range(DRAWS):
        pick = generator.integers(0, len(some), size)
        x = np.linalg.lstsq(some[pick], some_right[pick], rcond=None)[0]
        middle = float(np.median(np.abs(some_right - some @ x)))
        if middle < least:
            best, least = x, middle
    for _ in range(4):
        gap = np.abs(some_right - some @ best)
        near = gap <= np.median(gap)
        best = np.linalg.lstsq(some[near], some_right[near], rcond=None)[0]
    return np.asarray(best, dtype=np.float64)
