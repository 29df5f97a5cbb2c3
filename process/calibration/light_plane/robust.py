"""Owns robust linear least squares: a start that a quarter of wild values cannot move, then Tukey's weights."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

F8 = NDArray[np.float64]
DRAWS = 400
DRAW_ROWS = 8
FEW = 4000
"""Rows that judge the drawn solutions."""
TUKEY = 4.685
"""95 % efficient for normal errors."""
MAD_TO_SIGMA = 1.4826
ROUNDS = 30


class Solution(NamedTuple):
    """A robust fit of design @ x = values."""

    x: F8
    """[k]."""
    covariance: F8
    """[k, k], of independent errors."""
    weight: F8
    """[n] 0..1: Tukey's; 0 is an outlier."""
    scale: float
    """Robust standard deviation of a residual of unit prior weight."""


def solve(
    design: F8, values: F8, sigma: F8 | None = None, seed: int = 0, start: F8 | None = None, rounds: int = ROUNDS
) -> Solution:
    """Robust x of design [n, k] @ x = values [n]; ``sigma`` [n] are relative standard deviations of the values.

    With ``start`` [k], near the solution, nothing is drawn: quicker, and no defence against many wild values.
    """
    prior = np.ones(len(values)) if sigma is None else 1.0 / sigma
    rows, right = design * prior[:, None], values * prior
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
    return Solution(x / unit, covariance, weight, scale)


def _start(rows: F8, right: F8, generator: np.random.Generator) -> F8:
    """The drawn solution with the least median residual, then the best half of the rows twice."""
    chosen = generator.permutation(len(rows))[:FEW]
    some, some_right = rows[chosen], right[chosen]
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
