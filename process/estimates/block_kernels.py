"""Own the estimate of many pixels: fit each edge of a block of columns, and what its plateaus say against it."""

from __future__ import annotations

import math

import numpy as np

from process.compiled import kernel
from process.crossing_kernels import probit_fraction
from process.estimates.edge_kernels import SHARP, find_edge, fit_edge, sharp_samples
from process.quality import Quality

FAR = 200
"""Frames to each side of a first crossing that an edge is looked for in."""
TOO_NEAR_WIDTHS = 3.0
"""A plateau shorter than so many widths of the edge, and a frame, was not reached."""

FAINT = 225.0
"""Square of the range over the variance of the noise, below which a first crossing may be noise alone."""

_FILTERED = int(Quality.FILTERED)
_PLATEAU = int(Quality.PLATEAU_NOT_REACHED)
_NO_DARK = int(Quality.NO_DARK_LEVEL)
_SEVERAL = int(Quality.SEVERAL)


@kernel
def several_levels(samples, times, model, noise):
    """True if the light comes twice, or if a plateau of the whole stretch lies well beyond those of the edge."""
    low, height, crossing, width = model[0], model[1], model[2], model[3]
    dark = math.sqrt(max(noise[0] + noise[1] * low, 0.1))
    bright = math.sqrt(max(noise[0] + noise[1] * (low + height), 0.1))
    floor, roof = low - 0.15 * height - 5.0 * dark, low + 1.15 * height + 5.0 * bright
    middle = low + 0.5 * height
    margin = min(4.0 * 0.5 * (dark + bright), 0.25 * height)
    left = False
    for k in range(samples.size):
        value, from_edge = samples[k], times[k] - crossing
        if value < floor or value > roof:
            return True
        if from_edge < -3.0 * width - 1.0 and value > middle + margin:
            return True
        if from_edge > 3.0 * width + 1.0:
            if value < middle - margin:
                left = True
            elif left and value > middle + margin:
                return True
    return False


@kernel
def local_probit(samples, times, place, seen, noise, found):
    """Crossing of a sharp edge from the two samples about half brightness, between the levels right beside them.

    What is slow on a plateau (stray light before the edge, a lamp that drifts) does not move it. found: crossing,
    sigma (frames). False where there are no levels on both sides, or not the edge.
    """
    if place < 3 or place + 2 >= samples.size:
        return False
    low = 0.5 * (samples[place - 3] + samples[place - 2])
    high = 0.5 * (samples[place + 1] + samples[place + 2])
    if high - low < 0.5 * seen or high - low < 1.0:
        return False
    fraction, scatter = probit_fraction(samples[place - 1], samples[place], low, high)
    span = times[place] - times[place - 1]
    spread = max(noise[0] + noise[1] * 0.5 * (low + high), 1.0 / 12.0)
    found[0] = times[place - 1] + span * fraction
    found[1] = max(scatter * span, 0.5) * math.sqrt(spread) / (high - low + 1.0)
    return True


@kernel
def count_sharp(columns, start, noise):
    """(Samples between 10 and 90 %, edges) summed over the sharp edges of a block: columns [frames, pixels].

    Over edges at all phases the samples within an interval number as many as it is long: 2.563 widths.
    """
    guess = np.empty(4)
    within, edges = 0, 0
    for pixel in range(start.size):
        if start[pixel] < 0:
            continue
        first, end = max(0, start[pixel] - FAR), min(columns.shape[0], start[pixel] + FAR)
        samples = columns[first:end, pixel].astype(np.float64)
        place = start[pixel] - first
        spread = max(noise[0] + noise[1] * samples[place], 1.0 / 12.0)
        if find_edge(samples, place, 0.0, spread, guess) and guess[3] < SHARP:
            count = sharp_samples(samples, place)
            if count >= 0:
                within += count
                edges += 1
    return within, edges


@kernel
def fit_block(
    columns,
    present,
    pixels,
    start,
    lowest,
    highest,
    noise,
    sharp_width,
    local,
    lasting,
    crossing,
    sigma,
    quality,
    width,
):
    """Fit the pixels (places in columns [frames, :]) about their first crossing, place start[i] among the frames.

    lowest, highest [i]: extremes of the folded signal. local: a sharp edge that is no erf, or none that can be
    fitted, gets its crossing from local_probit. lasting [i]: bits of quality that no fit changes. Where one
    succeeds, crossing, sigma and width (all in frames) and quality, all [i], are replaced; else they stay.
    """
    guess, model, near_edge = np.empty(4), np.empty(8), np.empty(2)
    frames = columns.shape[0]
    for i in range(pixels.size):
        first = max(0, start[i] - FAR)
        end = min(frames, start[i] + FAR)
        samples = np.empty(end - first)
        for k in range(first, end):
            samples[k - first] = columns[k, pixels[i]]
        times = present[first:end]
        spread = max(noise[0] + noise[1] * 0.5 * (lowest[i] + highest[i]), 1.0 / 12.0)
        seen = (highest[i] - lowest[i]) - 5.0 * math.sqrt(spread)
        faint = (highest[i] - lowest[i]) ** 2 < FAINT * spread
        place = start[i] - first
        fits = find_edge(samples, place, seen, spread, guess)
        sharp = not fits or guess[3] < SHARP
        fits = fits and fit_edge(samples, times, guess, sharp_width, noise, model)
        fits = fits and abs(model[2] - crossing[i]) <= 4.0 * model[3] + 3.0
        uneven = local and sharp and not faint and not (fits and model[5] <= model[6])
        if uneven and local_probit(samples, times, place, seen, noise, near_edge):
            crossing[i], sigma[i] = near_edge[0], near_edge[1]
            continue
        if not fits:
            if local and faint:
                quality[i] |= _FILTERED
            continue
        crossing[i] = model[2]
        # a chi squared that chance explains says nothing about sigma
        sigma[i] = model[4] * math.sqrt(model[5]) if model[5] > model[6] else model[4]
        width[i] = model[3]
        near = TOO_NEAR_WIDTHS * model[3] + 1.0
        bits = int(lasting[i])
        if model[7] > 0.0 and times[times.size - 1] - model[2] < near:
            bits |= _PLATEAU
        if model[2] - times[0] < near:
            bits |= _NO_DARK
        if several_levels(samples, times, model, noise):
            bits |= _SEVERAL
        quality[i] = bits
