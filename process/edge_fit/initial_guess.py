"""Own where an edge is: a first guess of its levels, place and width, and the samples that a fit of it looks at.

samples are the folded signal of one pixel in levels, one for each present frame; places are ordinals of these.
"""

from __future__ import annotations

import math

import numpy as np

from process.numba_cache import kernel

ROOT_PI = 1.7724538509055159
LEAST_HALF = 3
"""Frames to each side that are looked at first: a pulse of light may be no longer than a few frames."""
CLEAR = 50.0
"""Least square of a step between two plateaus over the variance of their difference, about: no step of noise alone."""
LEAST_WIDTH, LEAST_VARIANCE = 0.15, 1.0 / 12.0
"""Frames; levels squared (rounding alone)."""
REACH_WIDTHS, LEAST_REACH = 10.0, 6
"""Half length of the fit's window in widths of the edge, and at least in frames."""
INNER_WIDTHS = 4.5
"""Beyond so many widths, and two frames, a sample counts as plateau: the model is off by 3e-6 of the height."""


@kernel
def guess_edge(samples, start, half, spread, guess):
    """Levels, place and width of an edge near a sample, from sums: guess = low, height, place (ordinal), width.

    samples [frames]; start: where to look; half: samples to each side; spread: variance of the noise.
    The outer halves of the window are taken for plateaus. Phi (1 - Phi) adds up to width / sqrt(pi),
    and the lit part of the window to the distance from the crossing to its end. False: no edge in it.
    """
    left, right = max(0, start - half), min(samples.size - 1, start + half)
    before, after = max(1, (start - left + 1) // 2), max(1, (right - start + 1) // 2)
    low = samples[left : left + before].mean()
    height = samples[right + 1 - after : right + 1].mean() - low
    if height <= 0.0:
        return False
    lit, partly = 0.0, 0.0
    for k in range(left, right + 1):
        share = (samples[k] - low) / height
        lit += share
        partly += share * (1.0 - share)
    partly += (right + 1 - left) * spread / (height * height)
    guess[0], guess[1] = low, height
    guess[2] = min(max(right + 0.5 - lit, float(left)), float(right))
    guess[3] = max(ROOT_PI * partly, LEAST_WIDTH)
    return True


@kernel
def find_edge(samples, start, range_seen, spread, guess):
    """The smallest window about `start` whose plateaus are flat leads to the guess; False: there is none.

    guess [6] = low, height, place, width, last sample that was asked for (it may lie beyond the end), least height
    of an edge that was taken for one: the outcome is the same for every range_seen up to twice that.
    """
    half = LEAST_HALF
    found = False
    while True:
        if guess_edge(samples, start, half, spread, guess):
            clear = guess[1] * guess[1] * ((half + 1) // 2) >= CLEAR * spread
            found = clear and guess[3] <= half / 6.0 and guess[1] >= 0.5 * range_seen
        if found or half >= samples.size:
            break
        half *= 2
    guess[4], guess[5] = start + half, guess[1]
    if not found:
        return False
    again = np.empty(4)
    middle, half = int(guess[2] + 0.5), max(LEAST_HALF, int(math.ceil(6.0 * guess[3])))
    guess[4] = max(guess[4], float(middle + half))
    if guess_edge(samples, middle, half, spread, again) and again[1] >= 0.5 * range_seen:
        guess[:4] = again
        guess[5] = min(guess[5], again[1])
    return True


@kernel
def sharp_samples(samples, start):
    """Number of samples between 10 and 90 % of an edge before `start`; -1: too near an end, or no flat levels."""
    if start < 5 or start + 4 > samples.size:
        return -1
    low = 0.5 * (samples[start - 4] + samples[start - 3])
    height = 0.5 * (samples[start + 2] + samples[start + 3]) - low
    if height <= 0.0:
        return -1
    count = 0
    for k in range(start - 2, start + 2):
        share = (samples[k] - low) / height
        if 0.1 < share < 0.9:
            count += 1
    return count


@kernel
def flat_end(samples, begin, step, count, level, tolerance):
    """Samples from `begin` in steps of +-1 until two in a row leave the level, at most `count`."""
    beside = 0
    for k in range(count):
        index = begin + step * k
        if index < 0 or index >= samples.size:
            return k
        beside = beside + 1 if abs(samples[index] - level) > tolerance else 0
        if beside == 2:
            return max(k - 3, 0)
    return count


@kernel
def window_of(samples, guess, noise, bounds):
    """Bounds of the fit: bounds = first, first inner, last inner, last ordinal, last sample that was asked for.

    Plateaus end where they change; the sample asked for may lie beyond the end.
    """
    low, height, place, width = guess[0], guess[1], guess[2], guess[3]
    inner = int(math.ceil(INNER_WIDTHS * width)) + 2
    reach = max(LEAST_REACH, int(math.ceil(REACH_WIDTHS * width)))
    middle = int(math.floor(place))
    last = samples.size - 1
    dark = 5.0 * math.sqrt(max(noise[0] + noise[1] * low, LEAST_VARIANCE))
    bright = 5.0 * math.sqrt(max(noise[0] + noise[1] * (low + height), LEAST_VARIANCE))
    near = int(math.ceil(3.0 * width)) + 1
    outer = max(reach - near, 0)
    bounds[0] = middle - near - flat_end(samples, middle - near, -1, outer, low, max(dark, 0.1 * height))
    bounds[3] = (
        middle + 1 + near + flat_end(samples, middle + 1 + near, 1, outer, low + height, max(bright, 0.1 * height))
    )
    bounds[4] = middle + 2 + near + outer
    bounds[0], bounds[3] = max(bounds[0], 0), min(bounds[3], last)
    bounds[1], bounds[2] = max(bounds[0], middle - inner), min(bounds[3], middle + 1 + inner)
