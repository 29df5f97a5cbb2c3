"""Weighted least-squares fit of an erf edge to the samples of one pixel, with the standard deviation of the crossing.

Model: level(t) = low + height Phi((t - crossing) / width), t in frames, levels of the folded signal. Variance of a
sample: noise[0] + noise[1] x level. Samples at noise[2] or below, or at noise[3] or above, are clipped: they say only
that the light was at least as dark or as bright. Parameters of the fit: low, height, crossing, log(width).
noise[4] is the step from one level that occurs to the next, noise[5] the levels of one count of 8 bit.

Levenberg-Marquardt with Huber weights and weak priors on crossing and width; sigma is the root of the crossing's
element of the inverse normal matrix. Float64, in the written order, so that results do not depend on who calls.
"""

# ruff: noqa: PLR0915 - unrolled sums: an array per sample would cost more than the arithmetic

from __future__ import annotations

import math

import numpy as np

from process.edge_fit.initial_guess import LEAST_VARIANCE, LEAST_WIDTH, window_of
from process.numba_cache import inlined_kernel, kernel

ROOT_2_PI = 2.5066282746310002
LOOSE_LOG_WIDTH, TIGHT_LOG_WIDTH = 0.7, 0.2
"""Prior standard deviation of log(width): about the pixel's own guess; for sharp edges, about the scan's width."""
SHARP = 1.0
"""Width in frames below which one pixel has too few samples to tell it; all sharp edges of the scan together do."""
MAX_STEPS = 12
"""Two to four suffice where there is an edge."""
CONVERGED_CHI2 = 0.01
"""A step that gains less chi squared ends the fit: what is left is a small part of a standard deviation."""
CURVATURE = 7.0
"""Share of the variance that the linearised fit misses, per (sigma / width)^2; found by simulation."""
HUBER = 4.0
"""Residuals beyond so many standard deviations are weighted down."""


_PER_UNIT, _FAR = 32, 9
_GRID = np.arange(-_FAR * _PER_UNIT, _FAR * _PER_UNIT + 1) / _PER_UNIT
_CDF = np.array([0.5 * math.erfc(-0.7071067811865476 * z) for z in _GRID])
_DENSITY = np.exp(-0.5 * _GRID * _GRID) / ROOT_2_PI
# Phi by a Taylor series about the nearest of these grid points: off by less than 2e-9, several times as fast as erfc.


@inlined_kernel
def normal_cdf_and_density(z):
    """Cumulative normal distribution and its density, to 2e-9."""
    bounded = min(max(z, -float(_FAR)), float(_FAR))
    index = int(bounded * _PER_UNIT + (_FAR * _PER_UNIT + 0.5))
    at = _GRID[index]
    d = bounded - at
    density = _DENSITY[index]
    second = at * at - 1.0
    third = (at * at - 3.0) * at
    cdf = _CDF[index] + density * d * (1.0 - d * (at / 2.0 - d * (second / 6.0 - d * third / 24.0)))
    return cdf, density * (1.0 - d * (at - d * (second / 2.0 - d * third / 6.0)))


@inlined_kernel
def _solve(matrix, vector, damping, lower, out):
    # Cholesky solution of (matrix + damping diag(matrix)) out = vector, 4 x 4; False where it is not positive definite.
    # Written out: a call of LAPACK takes longer than the arithmetic.
    for i in range(4):
        for j in range(i + 1):
            total = matrix[i, j]
            if i == j:
                total += damping * matrix[i, i]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                lower[i, i] = math.sqrt(total)
            else:
                lower[i, j] = total / lower[j, j]
    for i in range(4):
        total = vector[i]
        for k in range(i):
            total -= lower[i, k] * out[k]
        out[i] = total / lower[i, i]
    for back in range(4):
        i = 3 - back
        total = out[i]
        for k in range(i + 1, 4):
            total -= lower[k, i] * out[k]
        out[i] = total / lower[i, i]
    return True


@inlined_kernel
def _clipped_as_modelled(value, level, noise):
    # a clipped sample carries no information where the model lies beyond the clipping level too
    return (value >= noise[3] and level > value - 0.5) or (value <= noise[2] and level < value + 0.5)


@inlined_kernel
def _add_plateau(matrix, vector, sums, level, bright, noise):
    # sums: number, mean and sum of squares about the mean of the samples, number and level of the clipped ones.
    # All samples of a plateau have one model level: sum (y - level)^2 = squares + number (mean - level)^2.
    count, mean, squares = sums[0], sums[1], sums[2]
    if sums[3] > 0.0 and not _clipped_as_modelled(sums[4], level, noise):
        both = count + sums[3]
        squares += count * sums[3] / both * (mean - sums[4]) ** 2
        mean = (count * mean + sums[3] * sums[4]) / both
        count = both
    if count == 0.0:
        return 0.0
    variance = max(noise[0] + noise[1] * level, LEAST_VARIANCE)
    residual = (mean - level) * count / variance
    matrix[0, 0] += count / variance
    vector[0] += residual
    if bright:
        matrix[1, 0] += count / variance
        matrix[1, 1] += count / variance
        vector[1] += residual
    return (squares + count * (mean - level) ** 2) / variance


@kernel
def normal_equations(samples, times, bounds, flats, model, prior, noise, matrix, vector):
    """Weighted normal equations of the four parameters (low, height, crossing, log width); returns chi squared.

    bounds: of window_of; flats: of _flat_sums, below and above; prior: mean and standard deviation of the crossing, and
    of the log width; matrix [4, 4] (lower half) and vector [4] are overwritten.
    """
    low, height, crossing = model[0], model[1], model[2]
    width = math.exp(model[3])
    matrix[:] = 0.0
    vector[:] = 0.0
    chi = _add_plateau(matrix, vector, flats[0], low, False, noise)
    chi += _add_plateau(matrix, vector, flats[1], low + height, True, noise)
    # scalars for the ten sums: an array element per sum would be stored and loaded for each sample
    inverse = 1.0 / width
    a00, a10, a11, a20, a21, a22, a30, a31, a32, a33 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    b0, b1, b2, b3 = 0.0, 0.0, 0.0, 0.0
    for k in range(bounds[1], bounds[2] + 1):
        z = (times[k] - crossing) * inverse
        share, density = normal_cdf_and_density(z)
        level = low + height * share
        if _clipped_as_modelled(samples[k], level, noise):
            continue
        weight = 1.0 / max(noise[0] + noise[1] * level, LEAST_VARIANCE)
        residual = samples[k] - level
        square = residual * residual * weight
        if square > HUBER * HUBER:
            # Huber: quadratic near zero, linear beyond, so that one wild sample pulls with bounded force
            size = math.sqrt(square)
            square = HUBER * (2.0 * size - HUBER)
            weight *= HUBER / size
        chi += square
        # derivatives of the level by crossing and log width
        by_place = -height * density * inverse
        by_width = by_place * z * width
        w1, w2, w3 = weight * share, weight * by_place, weight * by_width
        a00 += weight
        a10 += w1
        a11 += w1 * share
        a20 += w2
        a21 += w2 * share
        a22 += w2 * by_place
        a30 += w3
        a31 += w3 * share
        a32 += w3 * by_place
        a33 += w3 * by_width
        b0 += weight * residual
        b1 += w1 * residual
        b2 += w2 * residual
        b3 += w3 * residual
    matrix[0, 0] += a00
    matrix[1, 0] += a10
    matrix[1, 1] += a11
    matrix[2, 0], matrix[2, 1], matrix[2, 2] = a20, a21, a22
    matrix[3, 0], matrix[3, 1], matrix[3, 2], matrix[3, 3] = a30, a31, a32, a33
    vector[0] += b0
    vector[1] += b1
    vector[2], vector[3] = b2, b3
    for i in range(2):
        stiff = 1.0 / (prior[2 * i + 1] * prior[2 * i + 1])
        away = model[2 + i] - prior[2 * i]
        matrix[2 + i, 2 + i] += stiff
        vector[2 + i] -= stiff * away
        chi += stiff * away * away
    return chi


@kernel
def _flat_sums(samples, begin, end, noise, out):
    # out: number, mean, and sum of squares about the mean of samples[begin:end]; number of clipped ones, their level
    count, clipped, mean, squares, level = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(begin, end):
        if noise[2] < samples[k] < noise[3]:
            count += 1.0
            mean += samples[k]
        else:
            clipped += 1.0
            level = samples[k]
    mean /= max(count, 1.0)
    for k in range(begin, end):
        if noise[2] < samples[k] < noise[3]:
            squares += (samples[k] - mean) ** 2
    out[0], out[1], out[2], out[3], out[4] = count, mean, squares, clipped, level


@kernel
def _count_clipped(samples, bounds, noise):
    # number of clipped samples within the bounds
    count = 0.0
    for k in range(bounds[0], bounds[3] + 1):
        count += not noise[2] < samples[k] < noise[3]
    return count


@kernel
def fit_edge(samples, times, guess, sharp_width, noise, model):
    """Fit an edge from a guess; returns False where it does not converge to an edge near the guess.

    Args:
        samples: [frames] levels.
        times: [frames] frame indices, float64.
        guess: low, height, place, width of ``initial_guess.find_edge``.
        sharp_width: width of the scan's sharp edges, in frames.
        noise: [6] variance = noise[0] + noise[1] level; clipping levels; step and count.
        model: [9] result: low, height, crossing (frames), width (frames), sigma (frames), chi squared per degree of
            freedom, the value of that which chance seldom exceeds, 1 if bright to the end of the samples, last sample
            asked for (always set).

    Where the samples tell nothing, as of the place of an edge that falls between two of them, the weak prior decides.
    """
    bounds = np.empty(5, np.int64)
    window_of(samples, guess, noise, bounds)
    model[8] = bounds[4]
    flats = np.empty((2, 5))
    _flat_sums(samples, bounds[0], bounds[1], noise, flats[0])
    _flat_sums(samples, bounds[2] + 1, bounds[3] + 1, noise, flats[1])
    place = int(guess[2])
    vectors = np.zeros((7, 4))
    now, tried, step, vector, new_vector = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4]
    clipped = _count_clipped(samples, bounds, noise)
    # a start at the clipping level would have every sample of that plateau explained, and no gradient: start beyond it
    below, above = 0.1 * guess[1] * (flats[0, 3] > 0.0), 0.1 * guess[1] * (flats[1, 3] > 0.0)
    now[0], now[1] = guess[0] - below, guess[1] + below + above
    if place + 1 < times.size:
        now[2] = times[place] + (guess[2] - place) * (times[place + 1] - times[place])
    else:
        now[2] = times[place]
    sharp = guess[3] < SHARP
    now[3] = math.log(sharp_width if sharp else guess[3])
    prior = vectors[5]
    prior[0], prior[1] = now[2], max(0.5, 2.0 * guess[3])
    prior[2], prior[3] = now[3], TIGHT_LOG_WIDTH if sharp else LOOSE_LOG_WIDTH
    work = np.empty((3, 4, 4))
    matrix, new_matrix = work[0], work[1]
    chi = normal_equations(samples, times, bounds, flats, now, prior, noise, matrix, vector)
    damping = 0.0
    settled = False
    for _ in range(MAX_STEPS):
        if not _solve(matrix, vector, damping, work[2], step):
            damping = max(10.0 * damping, 1e-3)
            continue
        # bounded steps: far from the edge the model is flat, and a full step would leave it for good
        wide = math.exp(now[3])
        most = max(2.0 * wide, 1.0)
        step[2] = min(max(step[2], -most), most)
        step[3] = min(max(step[3], -0.7), 0.7)
        tried[:] = now + step
        tried[3] = max(tried[3], math.log(LEAST_WIDTH))
        new_chi = normal_equations(samples, times, bounds, flats, tried, prior, noise, new_matrix, new_vector)
        if not new_chi <= chi + 1e-9:
            damping = max(10.0 * damping, 1e-2)
            if abs(step[2]) < 1e-5 * wide:
                settled = True
                break
            continue
        gain = chi - new_chi
        now[:], matrix[:], vector[:] = tried, new_matrix, new_vector
        chi = new_chi
        damping *= 0.1
        if gain < CONVERGED_CHI2:
            settled = True
            break
    # one column of the inverse normal matrix: step[2] is the variance of the crossing
    unit = vectors[6]
    unit[2] = 1.0
    if not settled or not _solve(matrix, unit, 0.0, work[2], step) or not step[2] > 0.0 or now[1] <= 0.0:
        return False
    if abs(now[2] - prior[0]) > 4.0 * guess[3] + 3.0:
        return False
    freedom = max(bounds[3] - bounds[0] + 1 - clipped - 4.0, 1.0)
    model[0], model[1], model[2], model[3] = now[0], now[1], now[2], math.exp(now[3])
    model[4], model[5] = math.sqrt(step[2]), chi / freedom
    if not sharp:  # where the noise is large, chi squared is no parabola over a standard deviation
        model[4] *= math.sqrt(1.0 + CURVATURE * step[2] / (model[3] * model[3]))
    model[6] = 1.0 + 4.0 * math.sqrt(2.0 / freedom)
    model[7] = 1.0 if bounds[3] == samples.size - 1 else 0.0
    return True
