"""Crossing of each pixel from the two samples about half brightness (algorithm 3 of the paper), its sigma and quality.

S = (minimum + maximum) / 2 and the crossing is t = p + (m - p) (S - I[p]) / (I[m] - I[p]), with m the first frame at or
above S and p the present frame before it (the paper's m - 1). ``probit`` interpolates in z = Phi^-1 of the level's
share
of the range instead: there an erf edge is a straight line.

Levels are of the folded signal (the complement for falling edges). Arithmetic is float64, in the written order: the
maps are compared bit for bit with a second implementation (tests/reference/two_pass.py).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from process.crossings.quality import Quality
from process.numba_cache import inlined_kernel, kernel
from process.pixel_layout import NEVER, NO_DIP

GAUSS = 2.5066
"""sqrt(2 pi), rounded: an erf edge of standard deviation w and height A has the greatest slope A / (GAUSS w)."""

_LIT = int(Quality.LIT_AT_START)
_PLATEAU = int(Quality.PLATEAU_NOT_REACHED)
_NO_DARK = int(Quality.NO_DARK_LEVEL)
_SEVERAL = int(Quality.SEVERAL)
_MISSING = int(Quality.MISSING_NEIGHBOUR)


class Samples(NamedTuple):
    """Input of the estimate for each pixel: flat arrays [pixels], levels of the folded signal."""

    minimum: NDArray[np.uint16]
    maximum: NDArray[np.uint16]
    first: NDArray[np.uint16]
    """Value in the first folded frame."""
    ordinal: NDArray[np.int32]
    """First frame at or above S, m, as its number among the folded frames; NEVER or UNKNOWN."""
    level: NDArray[np.uint16]
    """I[m]."""
    before: NDArray[np.uint16]
    """I[p], in the folded frame before it."""
    later_dip: NDArray[np.int32]
    """Lowest value from there to the last new maximum; NO_DIP where there is no later one."""
    last_ordinal: NDArray[np.int32]
    """Number of the frame of the first maximum."""
    tail_dip: NDArray[np.uint16]
    """Lowest value from the first maximum on."""
    tail_rise: NDArray[np.uint16]
    """Largest rise above the running lowest value from the first maximum on."""


@kernel
def sample_columns(columns, samples):
    """Fill samples by two passes over the levels of some pixels, columns [frames, pixels] of the folded signal."""
    frames, pixels = columns.shape
    for pixel in range(pixels):
        # algorithm 1
        high = np.int64(columns[0, pixel])
        low = high
        last = 0
        for k in range(1, frames):
            value = np.int64(columns[k, pixel])
            low = min(low, value)
            if value > high:
                high, last = value, k
        # algorithm 3; the loop ends, the maximum is at or above S
        first_above = 0
        while 2 * np.int64(columns[first_above, pixel]) < low + high:
            first_above += 1
        later = np.int64(NO_DIP)
        for k in range(first_above + 1, last + 1):
            later = min(later, np.int64(columns[k, pixel]))
        dip, rise = high, np.int64(0)
        for k in range(last, frames):
            value = np.int64(columns[k, pixel])
            dip = min(dip, value)
            rise = max(rise, value - dip)
        samples.minimum[pixel], samples.maximum[pixel] = low, high
        samples.first[pixel] = columns[0, pixel]
        samples.ordinal[pixel] = first_above if first_above > 0 else NEVER
        samples.level[pixel] = columns[first_above, pixel]
        samples.before[pixel] = columns[max(first_above - 1, 0), pixel]
        samples.later_dip[pixel], samples.last_ordinal[pixel] = later, last
        samples.tail_dip[pixel], samples.tail_rise[pixel] = dip, rise


@inlined_kernel
def _edge_quality(width, crossing, from_last_maximum, still_bright, first, last):
    # width: of the edge in frames, from the slope between the two samples. The maximum is too low if the sweep ended
    # while it still rose; a pixel that the light has left again had its plateau, however short.
    bits = 0
    if still_bright and from_last_maximum <= width + 1 and last - crossing < 2.5 * width + 1:
        bits |= _PLATEAU
    if crossing - first < 2.5 * width + 1:
        bits |= _NO_DARK
    return bits


@inlined_kernel
def _normal_density(z):
    return math.exp(-0.5 * z * z) / GAUSS


@kernel
def normal_quantile(p):
    """Inverse of the cumulative normal distribution, 0 < p < 1."""
    # Halley's iteration from the logistic distribution's quantile; four steps reach float64
    z = math.log(p / (1.0 - p)) / 1.702
    for _ in range(4):
        off = (0.5 * math.erfc(-z / math.sqrt(2.0)) - p) / _normal_density(z)
        z -= off / (1.0 + 0.5 * z * off)
    return z


@kernel
def probit_fraction(base, level, low, high, step, blur):
    """Where half brightness lies between two samples of an erf edge, 0..1, and sigma x (range + 2 blur) / noise.

    base, level: the two samples; low, high: levels of the plateaus; step: from one level that occurs to the next;
    blur: see ``blur_of``.
    """
    half = 0.5 * step
    span = high - low + step
    fraction, scatter = fraction_between(
        _quantile_of(base - low, span, half), _quantile_of(level - low, span, half), span
    )
    if blur > half:
        span = high - low + 2.0 * blur
        _, scatter = fraction_between(_quantile_of(base - low, span, blur), _quantile_of(level - low, span, blur), span)
    return fraction, scatter


@inlined_kernel
def blur_of(noise, step, count):
    """Half the interval that a level stands for where its error counts: of the noise, at most half a count of 8 bit.

    noise: standard deviation in levels; step: between two levels; count: levels of one count of 8 bit. Where the levels
    are finer than the noise, half a level above the dark plateau the error of the quantile would be a number of no
    meaning, and sigma would be huge.
    """
    return 0.5 * min(max(noise, step), count)


@inlined_kernel
def _quantile_of(above, span, blur):
    # the level stands for an interval: its middle, blur away from shares 0 and 1, where z is infinite
    least = blur / span
    return normal_quantile(min(max((above + blur) / span, least), 1.0 - least))


@kernel
def fill_quantiles(table):
    """Fill table[s, a] for a < s: quantile of the level a above the lowest of s levels, as in ``probit_fraction``."""
    for span in range(1, table.shape[0]):
        for above in range(span):
            table[span, above] = _quantile_of(np.float64(above), np.float64(span), 0.5)


@kernel
def fraction_between(z0, z1, span):
    """As ``probit_fraction``, from the quantiles z0, z1 of the two samples and the number of levels ``span``."""
    if z1 <= z0:
        return 0.5, span
    # error propagation: z = 0 lies at -z0 / (z1 - z0), and a level's error dI gives dz = dI / (span density(z))
    steep = (z1 - z0) * (z1 - z0)
    scatter = np.hypot(z1 / _normal_density(z0), z0 / _normal_density(z1)) / steep
    return min(max(-z0 / (z1 - z0), 0.0), 1.0), scatter


@kernel
def look_up(numbers, places, out):
    """out[i] = numbers[places[i]]."""
    for i in range(places.size):
        out[i] = numbers[places[i]]


@kernel
def estimate_crossings(selected, samples, present, noise, step, blur, probit, quantiles, crossing, sigma, quality):
    """Algorithm 3: crossing (frame index), sigma (frames) and quality of the selected pixels, from two samples.

    Args:
        selected: flat indices into samples and the outputs.
        samples: Samples.
        present: frame index of each folded frame.
        noise: standard deviation in levels.
        step: from one level that occurs to the next.
        blur: of ``blur_of``, in levels.
        probit: interpolate in the inverse normal of the share of the range, not in the levels.
        quantiles: [s, a] of ``fill_quantiles``, for a blur of 0.5 and ranges up to its size; may be empty.
        crossing: float64, written at selected pixels only; a pixel whose crossing is UNKNOWN is left alone.
        sigma: float32, likewise.
        quality: uint16, bits are added likewise.
    """
    first, last = present[0], present[present.size - 1]
    for index in range(selected.size):
        pixel = selected[index]
        low, high = np.int64(samples.minimum[pixel]), np.int64(samples.maximum[pixel])
        total = low + high  # 2 S: compared with twice a level, in exact integers
        if 2 * np.int64(samples.first[pixel]) >= total:
            quality[pixel] |= _LIT
            continue
        ordinal = samples.ordinal[pixel]
        # NEVER or UNKNOWN: the log has no crossing, or it has to be read from the file
        if ordinal < 0:
            continue
        after, before = present[ordinal], present[ordinal - 1]
        base = np.float64(samples.before[pixel])
        rise = np.float64(samples.level[pixel]) - base
        half = np.float64(total) / 2.0
        span = np.float64(after - before)
        # this product and quotient in this order: (half - base) / rise first would round differently
        time = before + span * (half - base) / rise
        fraction = (half - base) / rise
        scatter = noise * np.sqrt(fraction * fraction + (1.0 - fraction) * (1.0 - fraction)) / rise * span
        if probit:
            levels = high - low + 1
            if levels < quantiles.shape[0]:
                z0, z1 = quantiles[levels, samples.before[pixel] - low], quantiles[levels, samples.level[pixel] - low]
                fraction, scatter = fraction_between(z0, z1, np.float64(levels))
            else:
                fraction, scatter = probit_fraction(base, base + rise, np.float64(low), np.float64(high), step, blur)
            time, scatter = before + span * fraction, scatter * span * noise / (high - low + 2.0 * blur)
        crossing[pixel], sigma[pixel] = time, scatter
        # quality: several crossings where the pixel was down to a quarter of the range after it and rose again
        width = np.float64(high - low) / (GAUSS * rise / span)
        behind = np.float64(last - present[samples.last_ordinal[pixel]])
        still_bright = 2 * np.int64(samples.tail_dip[pixel]) >= total
        bits = _edge_quality(width, time, behind, still_bright, first, last)
        quarter = 3 * low + high
        if 4 * np.int64(samples.later_dip[pixel]) <= quarter:
            bits |= _SEVERAL
        if 4 * np.int64(samples.tail_dip[pixel]) <= quarter and 2 * np.int64(samples.tail_rise[pixel]) >= high - low:
            bits |= _SEVERAL
        if after - before > 1:
            bits |= _MISSING
        quality[pixel] |= bits
