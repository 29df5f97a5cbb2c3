"""Filters of the crossings for the default cloud: too uncertain ones, and isolated outliers.

Nothing is removed from the maps: such pixels get the quality bit FILTERED and are counted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from process.crossings.maps import Maps, quality_counts
from process.crossings.quality import Quality
from process.numba_cache import kernel

SIGMA_FRAMES = 1.0
"""A crossing known to within so many frames is not filtered by its sigma, unless the light came more than once;"""
SIGMA_MEDIANS = 6.0
"""nor is one known to within so many times the median sigma of the scan."""
RADIUS = 2
"""Neighbours are the pixels of a square of 2 x RADIUS + 1."""
MIN_AGREEING = 3
"""A crossing with fewer neighbours that agree with it may be an outlier;"""
MIN_NEIGHBOURS = 8
"""it is one only where at least so many neighbours have crossings, and these agree among themselves."""
AGREE_FRAMES, AGREE_SIGMAS = 6.0, 5.0
"""Two crossings agree within so many frames plus so many of their sigmas."""


def filtered(maps: Maps) -> Maps:
    """Maps with FILTERED set by sigma and by isolation, and the counts filtered_sigma and filtered_isolated."""
    known = np.isfinite(maps.crossing)
    quality = maps.quality.copy()
    uncertain = too_uncertain(maps.sigma, known, (quality & np.uint16(Quality.SEVERAL)) != 0)
    isolated = np.zeros(known.shape, np.bool_)
    mark_isolated(np.where(known & ~uncertain, maps.crossing, np.nan), maps.sigma, isolated)
    quality[uncertain | isolated] |= np.uint16(Quality.FILTERED)
    counts = maps.counts | quality_counts(maps.mask, maps.crossing, quality)
    counts |= {"filtered_sigma": int(uncertain.sum()), "filtered_isolated": int(isolated.sum())}
    return replace(maps, quality=quality, counts=counts)


def too_uncertain(
    sigma: NDArray[np.float32], known: NDArray[np.bool_], several: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Crossings ([h, w] bool) whose sigma is beyond the limits, or not a number.

    several: [h, w] the light came more than once; there the limit of SIGMA_FRAMES does not apply.
    """
    if not known.any():
        return np.zeros(known.shape, np.bool_)
    # not (sigma <= limit) instead of sigma > limit: NaN counts as too uncertain
    most = SIGMA_MEDIANS * float(np.nanmedian(sigma[known]))
    return known & ~(sigma <= np.where(several, most, max(SIGMA_FRAMES, most)))


@kernel
def mark_isolated(crossing, sigma, isolated):
    """Set isolated [h, w] where a crossing is far from its neighbours, and these agree with each other.

    crossing [h, w] in frames, NaN where there is none; sigma [h, w] in frames. At a step of depth a crossing has
    neighbours on its own side; where the neighbours scatter they decide nothing.
    """
    height, width = crossing.shape
    around = np.empty((2 * RADIUS + 1) ** 2)
    for row in range(height):
        for column in range(width):
            own = crossing[row, column]
            if np.isnan(own):
                continue
            tolerance = AGREE_FRAMES + AGREE_SIGMAS * sigma[row, column]
            count, agreeing = 0, 0
            for y in range(max(0, row - RADIUS), min(height, row + RADIUS + 1)):
                for x in range(max(0, column - RADIUS), min(width, column + RADIUS + 1)):
                    other = crossing[y, x]
                    if np.isnan(other) or (y == row and x == column):
                        continue
                    around[count] = other
                    count += 1
                    if abs(other - own) <= tolerance + AGREE_SIGMAS * sigma[y, x]:
                        agreeing += 1
            if agreeing >= MIN_AGREEING or count < MIN_NEIGHBOURS:
                continue
            neighbours = around[:count]
            # median and median deviation: a second outlier among the neighbours must not move their middle
            middle = np.median(neighbours)
            spread = np.median(np.abs(neighbours - middle))
            if spread <= AGREE_FRAMES / 2.0 and abs(own - middle) > tolerance + 8.0 * spread:
                isolated[row, column] = True
