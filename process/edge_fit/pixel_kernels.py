"""Edge estimates of many pixels: fit the edge of each, and check the samples after it for light that changes again.

Rows hold the original levels of a pixel at the places first .. end - 1 (numbers of frames among the folded ones); times
are frame indices, float64; noise [6] as in ``erf_fit_kernels``. Levels of the folded signal, float64, in the written
order.
"""

from __future__ import annotations

import math

import numpy as np

from process.crossings.quality import Quality
from process.crossings.two_sample_kernels import blur_of, probit_fraction
from process.edge_fit.erf_fit_kernels import SHARP, fit_edge
from process.edge_fit.initial_guess import find_edge, sharp_samples
from process.numba_cache import inlined_kernel, kernel

FAR = 200
"""Frames to each side of a first crossing in which its edge is looked for."""
TOO_NEAR_WIDTHS = 3.0
"""A plateau of fewer widths of the edge plus one frame counts as not reached."""

FAINT = 225.0
"""(range)^2 / variance of the noise below which a first crossing may be noise alone: a range of 15 sigma."""

NOTHING, FITTED, LOCAL, NOISE = range(4)
"""Outcomes: no estimate; a fit of the whole edge; two samples between the levels right beside the edge; no edge at all,
the range may be that of noise."""
LOW, HEIGHT, CROSSING, WIDTH, SIGMA, OPEN_END, ASKED, MOST_EXTENT, COURSE, COLUMNS = range(10)
"""Columns of an estimate: levels; crossing, width and sigma in frames; 1 if bright to the end of the samples; last
sample asked for; largest range of the pixel for which the outcome holds (see find_edge); course of the light
afterwards."""
STEADY, DARK_AGAIN, SEVERAL_LEVELS = 0.0, 1.0, 2.0
"""Courses: one edge so far; dark again after it; bright twice, or levels beyond both plateaus."""

_FILTERED = int(Quality.FILTERED)
_PLATEAU = int(Quality.PLATEAU_NOT_REACHED)
_NO_DARK = int(Quality.NO_DARK_LEVEL)
_SEVERAL = int(Quality.SEVERAL)


@kernel
def follow(samples, times, found, noise):
    """Update COURSE of an estimate with the samples after those seen before; in pieces or at once gives the same."""
    low, height, crossing, width = found[LOW], found[HEIGHT], found[CROSSING], found[WIDTH]
    dark = math.sqrt(max(noise[0] + noise[1] * low, 0.1))
    bright = math.sqrt(max(noise[0] + noise[1] * (low + height), 0.1))
    floor, roof = low - 0.15 * height - 5.0 * dark, low + 1.15 * height + 5.0 * bright
    # a sample counts as bright or dark only beyond the noise about half brightness
    middle = low + 0.5 * height
    margin = min(4.0 * 0.5 * (dark + bright), 0.25 * height)
    before, after = crossing - 3.0 * width - 1.0, crossing + 3.0 * width + 1.0
    left = found[COURSE] == DARK_AGAIN
    for k in range(samples.size):
        value, time = samples[k], times[k]
        beyond = value < floor or value > roof
        if beyond or (value > middle + margin and (time < before or (left and time > after))):
            found[COURSE] = SEVERAL_LEVELS
            return
        if value < middle - margin and time > after:
            left = True
    found[COURSE] = DARK_AGAIN if left else STEADY


@kernel
def local_probit(samples, times, place, seen, noise, found):
    """Crossing of a sharp edge by probit interpolation of two samples, between the levels right beside them.

    Slow changes of a plateau (stray light before the edge, a lamp that drifts) do not move it. place: the first sample
    at or above half brightness; seen: range less the noise. Sets LOW, HEIGHT, CROSSING, SIGMA of found. False where
    there are no samples on both sides, or where the step is not the pixel's edge.
    """
    if place < 3 or place + 2 >= samples.size:
        return False
    low = 0.5 * (samples[place - 3] + samples[place - 2])
    high = 0.5 * (samples[place + 1] + samples[place + 2])
    if high - low < 0.5 * seen or high - low < 1.0:
        return False
    span = times[place] - times[place - 1]
    spread = max(noise[0] + noise[1] * 0.5 * (low + high), 1.0 / 12.0)
    blur = blur_of(math.sqrt(spread), noise[4], noise[5])
    fraction, scatter = probit_fraction(samples[place - 1], samples[place], low, high, noise[4], blur)
    found[LOW], found[HEIGHT] = low, high - low
    found[CROSSING] = times[place - 1] + span * fraction
    found[SIGMA] = max(scatter * span, 0.5) * math.sqrt(spread) / (high - low + 2.0 * blur)
    return True


@inlined_kernel
def _stretch(row, count, full):
    # samples of the folded signal, float64; full: full scale for falling edges, whose complement is folded, else 0
    samples = np.empty(count)
    for k in range(count):
        samples[k] = full - float(row[k]) if full else float(row[k])
    return samples


@inlined_kernel
def _seen(extent, spread):
    # the extremes of a few hundred noisy samples lie about 2.5 sigma outside of the plateaus, on both sides
    return extent - 5.0 * math.sqrt(spread)


@inlined_kernel
def _extent_of(least_height, spread):
    # the largest integer extent with _seen(extent) <= 2 least_height: find_edge decides the same up to there
    most = math.floor(2.0 * least_height + 5.0 * math.sqrt(spread)) + 1.0
    while 0.5 * _seen(most, spread) > least_height:
        most -= 1.0
    return most


@kernel
def estimate_edge(samples, times, place, extent, noise, sharp_width, local, found):
    """Estimate the edge at sample `place`, the first at or above half brightness; returns one of the outcomes.

    samples, times [n]: levels and frames. extent: range of the pixel over the sweep. local: a sharp edge that is no
    erf, or cannot be fitted, gets its crossing from local_probit. found [COLUMNS] is filled.
    """
    guess, model = np.empty(6), np.empty(9)
    spread = max(noise[0] + noise[1] * samples[place], 1.0 / 12.0)
    seen = _seen(extent, spread)
    fits = find_edge(samples, place, seen, spread, guess)
    found[OPEN_END], found[ASKED], found[COURSE] = 0.0, guess[4] if fits else math.inf, STEADY
    least_height = guess[5] if fits else math.inf
    sharp = not fits or guess[3] < SHARP
    if fits:
        fits = fit_edge(samples, times, guess, sharp_width, noise, model)
        found[ASKED] = max(found[ASKED], model[8])
    # a fit that ran to another edge of the same pixel is none of this one
    fits = fits and abs(model[2] - times[place]) <= 4.0 * model[3] + 4.0
    faint = extent * extent < FAINT * spread
    uneven = local and sharp and not faint and not (fits and model[5] <= model[6])
    if uneven and local_probit(samples, times, place, seen, noise, found):
        found[MOST_EXTENT] = _extent_of(min(least_height, found[HEIGHT]), spread)
        found[WIDTH] = math.nan
        return LOCAL
    if not fits:
        return NOISE if local and faint else NOTHING
    found[LOW], found[HEIGHT], found[CROSSING], found[WIDTH] = model[0], model[1], model[2], model[3]
    # chi squared beyond chance: the model does not hold, and sigma grows with it
    found[SIGMA] = model[4] * math.sqrt(model[5]) if model[5] > model[6] else model[4]
    found[OPEN_END], found[MOST_EXTENT] = model[7], _extent_of(least_height, spread)
    return FITTED


@kernel
def count_sharp(rows, full, first, end, start, noise):
    """(samples between 10 and 90 %, edges) summed over the sharp edges of some pixels; [i] each but full and noise.

    start: place of the first level at or above half brightness.
    """
    # over edges at all phases as many samples fall into this interval on average as it is frames long: 2.563 widths
    guess = np.empty(6)
    within, edges = 0, 0
    for i in range(start.size):
        samples = _stretch(rows[i], end[i] - first[i], full)
        place = start[i] - first[i]
        spread = max(noise[0] + noise[1] * samples[place], 1.0 / 12.0)
        if find_edge(samples, place, 0.0, spread, guess) and guess[3] < SHARP:
            count = sharp_samples(samples, place)
            if count >= 0:
                within += count
                edges += 1
    return within, edges


@kernel
def estimate_rows(rows, full, times, first, end, start, extent, noise, sharp_width, local, early, outcome, found):
    """Estimate the edges of pixels, and follow their light to the end of their rows; [i] each unless said otherwise.

    rows [pixels, :]; full: see _stretch; times [frames]; start: place of the first level at or above half brightness;
    extent: range over the sweep; early: more frames are to come, and the outcome is NOTHING where they could change it.
    Fills outcome and found [i, COLUMNS].
    """
    for i in range(start.size):
        samples = _stretch(rows[i], end[i] - first[i], full)
        stretch = times[first[i] : end[i]]
        place = start[i] - first[i]
        outcome[i] = estimate_edge(samples, stretch, place, extent[i], noise, sharp_width, local, found[i])
        if early:
            spread = max(noise[0] + noise[1] * samples[place], 1.0 / 12.0)
            if not found[i, ASKED] + 1.0 < samples.size or extent[i] * extent[i] < FAINT * spread:
                outcome[i] = NOTHING
        if outcome[i] == FITTED:
            follow(samples, stretch, found[i], noise)


@kernel
def follow_rows(rows, full, times, first, end, noise, outcome, found):
    """Follow the light of fitted pixels over further rows [pixels, :]; changes found [i, COLUMNS]."""
    for i in range(first.size):
        if outcome[i] == FITTED and found[i, COURSE] != SEVERAL_LEVELS:
            samples = _stretch(rows[i], end[i] - first[i], full)
            follow(samples, times[first[i] : end[i]], found[i], noise)


@kernel
def conclude(pixels, first, end, times, outcome, found, noise, last_noise, lasting, crossing, sigma, quality, width):
    """Write the estimates of pixels (flat indices into the last five) as crossing, sigma, width (frames) and quality.

    first, end [i]: search window. noise: of the weighting that the samples had; last_noise: of the whole scan, to which
    sigma is scaled; lasting: quality bits that an estimate does not change. With the outcome NOTHING a pixel keeps what
    it has.
    """
    for i in range(pixels.size):
        if outcome[i] == NOTHING:
            continue
        pixel, own = pixels[i], found[i]
        if outcome[i] == NOISE:
            quality[pixel] |= _FILTERED
            continue
        half = own[LOW] + 0.5 * own[HEIGHT]
        weighed = max(noise[0] + noise[1] * half, 1.0 / 12.0)
        crossing[pixel] = own[CROSSING]
        sigma[pixel] = own[SIGMA] * math.sqrt(max(last_noise[0] + last_noise[1] * half, 1.0 / 12.0) / weighed)
        if outcome[i] == LOCAL:
            continue
        width[pixel] = own[WIDTH]
        near = TOO_NEAR_WIDTHS * own[WIDTH] + 1.0
        bits = int(lasting[pixel])
        if own[OPEN_END] > 0.0 and times[end[i] - 1] - own[CROSSING] < near:
            bits |= _PLATEAU
        if own[CROSSING] - times[first[i]] < near:
            bits |= _NO_DARK
        if own[COURSE] == SEVERAL_LEVELS:
            bits |= _SEVERAL
        quality[pixel] = bits
