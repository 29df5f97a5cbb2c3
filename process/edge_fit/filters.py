"""Owns what is taken out of the default cloud after the estimates: crossings too uncertain, and lonely flyers.

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
"""No crossing is filtered that is known to a frame, unless the light came more than once ..."""
SIGMA_MEDIANS = 6.0
"""... nor one that is known to so many times the median sigma of its scan."""
RADIUS = 2
"""Neighbours are the pixels of a square of 2 x RADIUS + 1."""
SUPPORT = 3
"""A crossing with fewer neighbours that agree with it may be a flyer."""
WITNESSES = 8
"""It is one only where so many neighbours have crossings that agree among themselves."""
AGREE_FRAMES, AGREE_SIGMAS = 6.0, 5.0
"""Two crossings agree within so many frames plus so many of their sigmas."""


def filtered(maps: Maps) -> Maps:
    """Maps with FILTERED set by sigma and by isolation, and the counts filtered_sigma and filtered_isolated."""
    known = np.isfinite(maps.crossing)
    quality = maps.quality.copy()
    uncertain = too_uncertain(maps.sigma, known, (quality & np.uint16(Quality.SEVERAL)) != 0)
    lonely = np.zeros(known.shape, np.bool_)
    flyers(np.where(known & ~uncertain, maps.crossing, np.nan), maps.sigma, lonely)
    quality[uncertain | lonely] |= np.uint16(Quality.FILTERED)
    counts = maps.counts | quality_counts(maps.mask, maps.crossing, quality)
    counts |= {"filtered_sigma": int(uncertain.sum()), "filtered_isolated": int(lonely.sum())}
    return replace(maps, quality=quality, counts=counts)


def too_uncertain(
    sigma: NDArray[np.float32], known: NDArray[np.bool_], several: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Crossings ([h, w] bool) whose sigma is beyond the limits, or not a number.

    several: the light came more than once; such an edge that does not look like one has no right to a frame.
    """
    if not known.any():
        return np.zeros(known.shape, np.bool_)
    most = SIGMA_MEDIANS * float(np.nanmedian(sigma[known]))
    return known & ~(sigma <= np.where(several, most, max(SIGMA_FRAMES, most)))


@kernel
def flyers(crossing, sigma, lonely):
    """Set lonely [h, w] where a crossing stands alone: far from all its neighbours, which agree with each other.

    crossing [h, w] in frames, NaN where there is none; sigma [h, w] in frames. An edge of depth has company on
    its own side, and where the neighbours do not agree they are no witnesses.
    """
    height, width = crossing.shape
    around = np.empty((2 * RADIUS + 1) ** 2)
    for row in range(height):
        for column in range(width):
            own = crossing[row, column]
            if np.isnan(own):
                continue
            tolerance = AGREE_FRAMES + AGREE_SIGMAS * sigma[row, column]
            count, support = 0, 0
            for y in range(max(0, row - RADIUS), min(height, row + RADIUS + 1)):
                for x in range(max(0, column - RADIUS), min(width, column + RADIUS + 1)):
                    other = crossing[y, x]
                    if np.isnan(other) or (y == row and x == column):
                        continue
                    around[count] = other
                    count += 1
                    if abs(other - own) <= tolerance + AGREE_SIGMAS * sigma[y, x]:
                        support += 1
            if support >= SUPPORT or count < WITNESSES:
                continue
            witnesses = around[:count]
            middle = np.median(witnesses)
            spread = np.median(np.abs(witnesses - middle))
            if spread <= AGREE_FRAMES / 2.0 and abs(own - middle) > tolerance + 8.0 * spread:
                lonely[row, column] = True
