"""Whole-edge estimates of a scan: reads it again in blocks of pixels, in two threads and bounded memory.

The result does not depend on the blocks, on the threads, or on what was estimated early. Maps [h, w]; crossing, sigma
and width in frames, noise in levels of the stored depth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from process.crossings.maps import Maps, full_scale, quality_counts
from process.crossings.quality import Quality
from process.edge_fit.early_estimates import (
    EarlyEstimates,
    EdgeEstimates,
    estimate_pixels,
    follow_pixels,
    search_window,
)
from process.edge_fit.noise_model import NoiseModel, assumed_noise
from process.edge_fit.pixel_kernels import NOTHING, conclude
from process.edge_fit.weighting import EdgeWeighting, FrameSequence, WeightingFinder, grid, noise_of, sharp_width_of

Method: TypeAlias = Literal["linear", "probit", "fit", "auto"]

BLOCK_PIXELS = 1024
"""Pixels of one block: their columns fit into the cache."""
THREADS = 2
NOISE_PIXELS = 6_000
"""Pixels with a crossing, evenly chosen, in which the noise of the whole scan is measured;"""
DARK_PIXELS = 1000
"""and pixels of the whole image, with a crossing or without, that are added to them."""


@dataclass(frozen=True)
class Refined:
    """Maps with whole-edge estimates, the measured noise, and the widths of the edges."""

    maps: Maps
    noise: NoiseModel
    """Of the folded signal, in levels of the stored depth."""
    width: NDArray[np.float32]
    """[h, w] standard deviation of the edge in frames; NaN where nothing was fitted."""


def refine(
    maps: Maps, method: Method, sequence: FrameSequence, noise_counts: float, early: EarlyEstimates | None = None
) -> Refined:
    """Estimate the crossings of ``maps`` anew by ``method``, with sigma from the measured noise.

    ``probit`` keeps its crossings and gets its sigma from that noise. ``fit`` has no crossing where
    the edge cannot be fitted; ``auto`` keeps that of ``maps`` there.

    Args:
        maps: of two samples, linear or probit.
        method: the estimate.
        sequence: the frames of the maps.
        noise_counts: standard deviation in counts of 8 bit, for a scan too short or too sparse to measure its own.
        early: estimates of the same frames that are there already.

    Raises:
        ScanFileError: the scan file was cut short.
    """
    fallback = assumed_noise(noise_counts * 2.0 ** (sequence.bit_depth - 8))
    start = starts(maps, sequence.present)
    noise = measure_noise(start, sequence, maps.mask.shape, fallback)
    maps = _with_measured_sigma(maps, sequence, noise, noise_counts)
    width: NDArray[np.float32] = np.full(maps.mask.shape, np.nan, np.float32)
    if method in ("fit", "auto"):
        finder = early.weighting_finder if early is not None else WeightingFinder(maps.mask.shape, fallback)
        finder.advance(sequence, len(sequence.present))
        weighting = finder.weighting or EdgeWeighting(noise, _sharp_width(start, sequence, noise))
        given = _FitInput(start, sequence, noise, weighting, early if finder.weighting else None, keep=method == "auto")
        maps = _fitted(maps, given, width)
    return Refined(maps, noise, width)


def starts(maps: Maps, present: NDArray[np.int64]) -> NDArray[np.int64]:
    """Place of each pixel's first frame at or above half brightness, int64 [h * w]; -1 for none."""
    crossing = maps.crossing.ravel()
    found: NDArray[np.int64] = np.full(crossing.size, -1, np.int64)
    known = np.flatnonzero(np.isfinite(crossing))
    # a crossing lies in (p, m]: the first present frame at or after it is m
    found[known] = np.minimum(np.searchsorted(present, crossing[known], side="left"), len(present) - 1)
    return found


def measure_noise(
    start: NDArray[np.int64], sequence: FrameSequence, shape: tuple[int, int], fallback: NoiseModel
) -> NoiseModel:
    """Noise of the folded signal from the plateaus beside the crossings of a scan; start as in :func:`starts`."""
    known = np.flatnonzero(start >= 0)
    chosen = known[:: max(1, -(-len(known) // NOISE_PIXELS))]
    pixels = np.unique(np.concatenate([chosen, grid(shape, DARK_PIXELS)]))
    return noise_of(sequence, pixels, start[pixels], fallback)


def _sharp_width(start: NDArray[np.int64], sequence: FrameSequence, noise: NoiseModel) -> float:
    known = np.flatnonzero(start >= 0)
    return sharp_width_of(sequence, known, start[known], noise)


def _with_measured_sigma(maps: Maps, sequence: FrameSequence, noise: NoiseModel, noise_counts: float) -> Maps:
    """Sigma of two samples scaled from the configured noise to the measured one at half brightness."""
    configured = noise_counts * 2.0 ** (sequence.bit_depth - 8)
    if configured <= 0:
        return maps
    known = np.flatnonzero(np.isfinite(maps.sigma))
    # sigma of two samples is proportional to the noise about half brightness
    half = (maps.minimum.ravel()[known].astype(np.float64) + maps.maximum.ravel()[known]) / 2
    if sequence.edge == "falling":
        half = full_scale(sequence.bit_depth) - half
    measured = np.sqrt(np.maximum(noise.floor + noise.slope * half, 1.0 / 12.0))
    sigma = maps.sigma.copy()
    sigma.reshape(-1)[known] *= (measured / configured).astype(np.float32)
    return replace(maps, sigma=sigma)


_Step: TypeAlias = Callable[[NDArray[np.int64]], EdgeEstimates]


@dataclass(frozen=True)
class _FitInput:
    """Input of the edge fits beside the maps."""

    start: NDArray[np.int64]
    sequence: FrameSequence
    noise: NoiseModel
    weighting: EdgeWeighting
    early: EarlyEstimates | None
    keep: bool
    """Pixels without a fit keep their two-sample crossing."""


def _estimated(given: _FitInput, pixels: NDArray[np.int64], extent: NDArray[np.float64]) -> EdgeEstimates:
    """Estimates of pixels: early ones, followed to the end of their search window, and new ones for all others."""
    start, sequence, weighting = given.start[pixels], given.sequence, given.weighting
    found = given.early.known(pixels, start, extent) if given.early is not None else EdgeEstimates.empty(len(pixels))
    old, new = np.flatnonzero(found.outcome != NOTHING), np.flatnonzero(found.outcome == NOTHING)

    def follow(some: NDArray[np.int64]) -> EdgeEstimates:
        part = found.take(some)
        follow_pixels(sequence, weighting, pixels[some], start[some], part)
        return part

    def estimate(some: NDArray[np.int64]) -> EdgeEstimates:
        return estimate_pixels(sequence, weighting, pixels[some], start[some], extent[some], local=given.keep)

    # the kernels release the interpreter lock, and each block writes its own pixels
    with ThreadPoolExecutor(THREADS) as pool:
        for some, part in pool.map(lambda todo: (todo[1], todo[0](todo[1])), _blocks((estimate, new), (follow, old))):
            for column, values in zip(found, part, strict=True):
                column[some] = values
    return found


def _blocks(*todo: tuple[_Step, NDArray[np.int64]]) -> Iterator[tuple[_Step, NDArray[np.int64]]]:
    """Each step with its pixels, in blocks."""
    for step, pixels in todo:
        for begin in range(0, len(pixels), BLOCK_PIXELS):
            yield step, pixels[begin : begin + BLOCK_PIXELS]


def _fitted(maps: Maps, given: _FitInput, width: NDArray[np.float32]) -> Maps:
    crossing, sigma, quality = maps.crossing.copy(), maps.sigma.copy(), maps.quality.copy()
    pixels = np.flatnonzero(given.start >= 0)
    extent = maps.maximum.ravel()[pixels].astype(np.float64) - maps.minimum.ravel()[pixels]
    found = _estimated(given, pixels, extent)
    noises = (given.weighting.noise_coefficients(given.sequence), given.noise.coefficients())
    kept_bits = _kept_bits(maps, given.sequence).ravel()
    stretch = search_window(given.start[pixels], len(given.sequence.present))
    outputs = [array.reshape(-1) for array in (crossing, sigma, quality, width)]
    conclude(pixels, *stretch, given.sequence.times, found.outcome, found.columns, *noises, kept_bits, *outputs)
    # ``fit`` shows what the fit alone does: no two-sample crossing where it failed
    if not given.keep:
        failed = np.isfinite(crossing) & np.isnan(width)
        crossing[failed], sigma[failed] = np.nan, np.nan
    counts = maps.counts | quality_counts(maps.mask, crossing, quality) | {"fitted": int(np.isfinite(width).sum())}
    return replace(maps, crossing=crossing, sigma=sigma, quality=quality, counts=counts)


def _kept_bits(maps: Maps, sequence: FrameSequence) -> NDArray[np.uint16]:
    """Quality bits that do not depend on the estimate, [h, w]."""
    judged = np.uint16(Quality.PLATEAU_NOT_REACHED | Quality.SEVERAL | Quality.NO_DARK_LEVEL)
    kept_bits: NDArray[np.uint16] = (maps.quality & ~judged).astype(np.uint16)
    bright = np.asarray(maps.minimum > full_scale(sequence.bit_depth) // 2) & (maps.mask != 0)
    kept_bits[bright] |= np.uint16(Quality.NO_DARK_LEVEL)
    return kept_bits
