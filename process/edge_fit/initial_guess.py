"""First guess of an edge (levels, place, width), and the window of samples that its fit uses.

samples [frames]: float64 levels of the folded signal of one pixel, one for each present frame; places are their
ordinals. Each function also reports the last sample it asked for, so that a fit made during the sweep is kept only if
all of these were there.
"""

from __future__ import annotations

import math

import numpy as np

from process.numba_cache import kernel

ROOT_PI = 1.7724538509055159
LEAST_HALF = 3
"""Half length in frames of the first window: a pulse of light may be no longer than a few frames."""
CLEAR = 50.0
"""Least (step between two plateaus)^2 over about the variance of their difference: noise alone makes no such step."""
LEAST_WIDTH, LEAST_VARIANCE = 0.15, 1.0 / 12.0
"""In frames; in levels squared, that of rounding."""
REACH_WIDTHS, LEAST_REACH = 10.0, 6
"""Half length of the fit's window: in widths of the edge, and at least in frames."""
INNER_WIDTHS = 4.5
"""Beyond so many widths and two frames a sample counts as plateau; the model is off by 3e-6 of the height there."""


@kernel
def guess_edge(samples, start, half, spread, guess):
    """Levels, place and width of an edge within a window, from sums over it; False where nothing rises.

    start: middle of the window; half: samples to each side; spread: variance of the noise; guess [4] = low, height,
        place (ordinal), width (frames).
    """
    # the outer half of each side is taken for a plateau
    left, right = max(0, start - half), min(samples.size - 1, start + half)
    before, after = max(1, (start - left + 1) // 2), max(1, (right - start + 1) // 2)
    low = samples[left : left + before].mean()
    height = samples[right + 1 - after : right + 1].mean() - low
    if height <= 0.0:
        return False
    # With share = Phi((t - crossing) / width): the shares add up to the distance from the crossing to the window's end,
    # and share (1 - share) to width / sqrt(pi). The noise makes the latter too small by its variance per sample.
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
    """Guess the edge from the smallest window about `start` that has flat plateaus; False where there is none.

    range_seen: range of the pixel's levels less the noise; an edge of less than half of it is not the pixel's edge.
    guess [6] = low, height, place, width, last sample asked for (it may lie beyond the end), least height of an edge
    that was accepted: the outcome is the same for every range_seen up to twice that.
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
    # once more about the edge itself: the first window began at the first sample above half brightness
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
    """Number of samples from `begin` in steps of +-1 before two in a row leave the level, at most `count`."""
    beside = 0
    for k in range(count):
        index = begin + step * k
        if index < 0 or index >= samples.size:
            return k
        beside = beside + 1 if abs(samples[index] - level) > tolerance else 0
        if beside == 2:
            return max(k - 3, 0)  # without these two, and two more beside them
    return count


@kernel
def window_of(samples, guess, noise, bounds):
    """Window of the fit: bounds [5] = first, first inner, last inner, last ordinal, last sample asked for.

    Inner samples are modelled one by one, those outside as plateaus. A plateau ends where its level changes. The sample
    asked for may lie beyond the end.
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
