"""Owns the estimates that look at the whole edge: reads the scan again in blocks of rows, on two cores.

Promises the same result however the blocks are cut and whichever thread takes them, in bounded memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from process.crossings import Edge, Maps, full_scale, quality_counts
from process.estimates.block_kernels import count_sharp, fit_block
from process.estimates.noise import NoiseModel, assumed_noise, guard_frames, model_from, noise_figures
from process.quality import Quality

Method: TypeAlias = Literal["linear", "probit", "fit", "auto"]
ReadRows: TypeAlias = Callable[[int, int], NDArray[Any]]
"""(first row, number of rows) -> original grey values [folded frames, rows, w] of those rows."""

BLOCK_BYTES = 6_000_000
"""Grey bytes of one block: small enough for the cache, large enough that the calls do not count."""
THREADS = 2
NOISE_BLOCKS = 12
"""Blocks, spread over the image, that the noise is measured in."""
SAMPLES_PER_WIDTH = 2.5631
"""Length of the interval from 10 to 90 % of an erf edge, in widths."""
NOISE_PIXELS = 1500
"""Pixels at most of each of them."""


@dataclass(frozen=True)
class Sequence:
    """A scan as the estimates see it."""

    read_rows: ReadRows
    present: NDArray[np.int64]
    """Frame index of each folded frame, ascending."""
    edge: Edge
    bit_depth: int


@dataclass(frozen=True)
class Refined:
    """Maps after the second look, and what was learnt on the way."""

    maps: Maps
    noise: NoiseModel
    """Of the folded signal, in levels of the stored depth."""
    width: NDArray[np.float32]
    """[h, w] standard deviation of the edge in frames; NaN where nothing was fitted."""


def refine(maps: Maps, method: Method, sequence: Sequence, noise_counts: float) -> Refined:
    """The crossings of ``maps`` (linear or probit) estimated anew by ``method``, with sigma from the measured noise.

    ``probit`` only gets its sigma from that noise. ``fit`` has no crossing where the edge cannot be fitted; ``auto``
    keeps that of ``maps`` there. noise_counts: standard deviation in counts of 8 bit, for a scan too short or too
    sparse to measure its own.

    Raises:
        ScanFileError: the scan file was cut short.
    """
    noise = measure_noise(maps, sequence, assumed_noise(noise_counts * 2.0 ** (sequence.bit_depth - 8)))
    maps = _with_measured_sigma(maps, sequence, noise, noise_counts)
    width: NDArray[np.float32] = np.full(maps.mask.shape, np.nan, np.float32)
    if method in ("fit", "auto"):
        maps = _fitted(maps, sequence, noise, width, keep=method == "auto")
    return Refined(maps, noise, width)


def _folded(sequence: Sequence, values: NDArray[Any]) -> NDArray[Any]:
    """Original grey [frames, rows, w] as the fold sees it, [frames, pixels]."""
    columns = values.reshape(len(values), -1)
    return full_scale(sequence.bit_depth) - columns if sequence.edge == "falling" else columns


def _blocks(maps: Maps, sequence: Sequence) -> Iterator[tuple[int, int]]:
    """(first row, number of rows) of the blocks that hold a crossing."""
    height, width = maps.mask.shape
    row_bytes = len(sequence.present) * width * maps.minimum.dtype.itemsize
    rows = max(1, min(height, BLOCK_BYTES // max(row_bytes, 1)))
    wanted = np.asarray(np.isfinite(maps.crossing).any(axis=1))
    for first in range(0, height, rows):
        if wanted[first : first + rows].any():
            yield first, min(rows, height - first)


def _starts(crossing: NDArray[np.float64], present: NDArray[np.int64]) -> NDArray[np.int64]:
    """Place among the folded frames of the first one at or above half brightness; -1 without a crossing."""
    known = np.isfinite(crossing)
    places = np.searchsorted(present, np.where(known, crossing, 0.0), side="left")
    return np.where(known, np.minimum(places, len(present) - 1), -1).astype(np.int64)


def measure_noise(maps: Maps, sequence: Sequence, fallback: NoiseModel) -> NoiseModel:
    """Noise of the folded signal from the flat stretches of blocks spread over the image."""
    blocks = list(_blocks(maps, sequence))
    chosen = [blocks[i] for i in np.unique(np.linspace(0, len(blocks) - 1, NOISE_BLOCKS).astype(int))] if blocks else []
    full = full_scale(sequence.bit_depth)
    guard = guard_frames(len(sequence.present))

    def figures(block: tuple[int, int]) -> NDArray[np.float64]:
        rows = min(block[1], -(-NOISE_PIXELS // maps.mask.shape[1]))
        first = block[0] + (block[1] - rows) // 2
        columns = _folded(sequence, sequence.read_rows(first, rows))
        start = _starts(maps.crossing[first : first + rows].ravel(), sequence.present)
        found = np.empty((2 * NOISE_PIXELS, 2))
        stride = max(1, columns.shape[1] // NOISE_PIXELS)
        return found[: noise_figures(columns, start, guard, stride, full, found)]

    with ThreadPoolExecutor(THREADS) as pool:
        return model_from(pool.map(figures, chosen), full, fallback)


def sharp_width_of(maps: Maps, sequence: Sequence, noise: NoiseModel) -> float:
    """Width in frames of the sharp edges of a scan, from how many samples fall into them; 0.5 where there are few."""
    blocks = list(_blocks(maps, sequence))
    chosen = [blocks[i] for i in np.unique(np.linspace(0, len(blocks) - 1, NOISE_BLOCKS).astype(int))] if blocks else []

    def count(block: tuple[int, int]) -> tuple[int, int]:
        row = block[0] + block[1] // 2
        start = _starts(maps.crossing[row], sequence.present)
        found: tuple[int, int] = count_sharp(_folded(sequence, sequence.read_rows(row, 1)), start, noise.coefficients())
        return found

    with ThreadPoolExecutor(THREADS) as pool:
        within, edges = np.array([(0, 0), *pool.map(count, chosen)]).sum(axis=0)
    return float(np.clip(within / (SAMPLES_PER_WIDTH * edges), 0.2, 1.0)) if edges >= 50 else 0.5


def _with_measured_sigma(maps: Maps, sequence: Sequence, noise: NoiseModel, noise_counts: float) -> Maps:
    """Sigma of two samples scaled from the configured noise to the measured one at half brightness."""
    half = (maps.minimum.astype(np.float64) + maps.maximum) / 2
    if sequence.edge == "falling":
        half = full_scale(sequence.bit_depth) - half
    measured = np.sqrt(np.maximum(noise.floor + noise.slope * half, 1.0 / 12.0))
    configured = noise_counts * 2.0 ** (sequence.bit_depth - 8)
    if configured <= 0:
        return maps
    return replace(maps, sigma=(maps.sigma * (measured / configured)).astype(np.float32))


def _fitted(maps: Maps, sequence: Sequence, noise: NoiseModel, width: NDArray[np.float32], *, keep: bool) -> Maps:
    crossing, sigma, quality = maps.crossing.copy(), maps.sigma.copy(), maps.quality.copy()
    outputs: list[NDArray[Any]] = [crossing, sigma, quality, width]
    lasting = _lasting_bits(maps, sequence)
    present = sequence.present.astype(np.float64)
    full = full_scale(sequence.bit_depth)
    sharp_width = sharp_width_of(maps, sequence, noise)
    low, high = maps.minimum.astype(np.float64), maps.maximum.astype(np.float64)
    if sequence.edge == "falling":
        low, high = full - high, full - low

    def fit(block: tuple[int, int]) -> None:
        rows = slice(block[0], block[0] + block[1])
        pixels = np.flatnonzero(np.isfinite(maps.crossing[rows]))
        parts = [np.ascontiguousarray(array[rows].ravel()[pixels]) for array in outputs]
        start = _starts(np.asarray(parts[0], np.float64), sequence.present)
        given = [array[rows].ravel()[pixels] for array in (low, high)]
        columns = _folded(sequence, sequence.read_rows(*block))
        told = (noise.coefficients(), sharp_width, keep, lasting[rows].ravel()[pixels])
        fit_block(columns, present, pixels, start, *given, *told, *parts)
        for array, part in zip(outputs, parts, strict=True):
            array[rows].reshape(-1)[pixels] = part

    with ThreadPoolExecutor(THREADS) as pool:
        for _ in pool.map(fit, _blocks(maps, sequence)):
            pass
    if not keep:
        failed = np.isfinite(crossing) & np.isnan(width)
        crossing[failed], sigma[failed] = np.nan, np.nan
    counts = maps.counts | quality_counts(maps.mask, crossing, quality) | {"fitted": int(np.isfinite(width).sum())}
    return replace(maps, crossing=crossing, sigma=sigma, quality=quality, counts=counts)


def _lasting_bits(maps: Maps, sequence: Sequence) -> NDArray[np.uint16]:
    """Bits that do not depend on the estimate, [h, w]."""
    judged = np.uint16(Quality.PLATEAU_NOT_REACHED | Quality.SEVERAL | Quality.NO_DARK_LEVEL)
    lasting: NDArray[np.uint16] = (maps.quality & ~judged).astype(np.uint16)
    bright = np.asarray(maps.minimum > full_scale(sequence.bit_depth) // 2) & (maps.mask != 0)
    lasting[bright] |= np.uint16(Quality.NO_DARK_LEVEL)
    return lasting
