"""Measures the crossing estimates against the Cramer-Rao bound, on synthetic edges, and their speed.

Edges pass all steps of a scan: fold, mask, crossing, measured noise, fit, filters.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from collections.abc import Sequence as Series
from dataclasses import replace
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from process.crossings.maps import Maps
from process.crossings.quality import Quality
from process.edge_fit.filters import filtered
from process.edge_fit.pixel_columns import columns_of_stack
from process.edge_fit.refine import Method, refine
from process.edge_fit.weighting import FrameSequence
from process.fold.fold import Fold
from tests.bench.cramer_rao import crossing_bound

PHASES = 16
DARK = 20.0
"""Level of the dark plateau."""
FRAMES = 200
FLAGGED = 1 | 2 | 4 | 8 | 16 | 128
"""Quality bits of a crossing that may be wrong."""
WIDTHS = (0.3, 0.7, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0)
LEVELS = ((30.0, 1.0), (30.0, 2.0), (30.0, 5.0), (100.0, 1.0), (100.0, 2.0), (100.0, 5.0), (200.0, 1.0), (200.0, 5.0))
"""(contrast, noise), in counts."""
CLIPPED_WIDTHS = (1.5, 4.0, 8.0)
CLIPPED_LEVELS = ((230.0, 2.0), (290.0, 2.0), (290.0, 5.0), (400.0, 2.0))
"""Plateaus at 250, 310 and 420 of 255."""
METHODS: tuple[Method, ...] = get_args(Method)


class Case(NamedTuple):
    """Result of an estimate on one kind of edge."""

    width: float
    """Standard deviation of the edge in frames."""
    contrast: float
    noise: float
    method: str
    times_bound: float
    """RMS of error / bound, over the pixels that are not flagged."""
    worst_bias: float
    """Largest mean error of the 16 phases, in units of the limit max(0.02 frame, 0.1 x bound)."""
    within_68: float
    """Share of the errors within one sigma."""
    within_95: float
    """Share within 1.96 sigma."""
    unflagged: float
    """Share of the pixels that have a crossing without a bit of FLAGGED."""


def made_edges(width: float, contrast: float, noise: float, pixels: int, seed: int = 1) -> NDArray[np.uint8]:
    """Frames [FRAMES, rows, 64] of erf edges that cross at FRAMES / 2 + phase, phases 0/16 to 15/16 in turn."""
    rng = np.random.default_rng(seed)
    z = (np.arange(FRAMES)[:, None] - true_crossing(PHASES)) / width
    edge = DARK + contrast * 0.5 * np.vectorize(math.erfc)(-z / math.sqrt(2))
    rows = -(-pixels // 64)
    clean = np.tile(edge, (1, rows * 64 // PHASES)).reshape(FRAMES, rows, 64)
    clean += noise * rng.standard_normal(clean.shape, np.float32)
    return np.clip(np.rint(clean), 0, 255).astype(np.uint8)


def true_crossing(pixels: int) -> NDArray[np.float64]:
    """Crossings of :func:`made_edges`, [pixels] in frames."""
    return FRAMES // 2 + (np.arange(pixels) % PHASES) / PHASES


def estimated(frames: NDArray[np.uint8], method: Method, contrast: int, noise_counts: float) -> Maps:
    """Maps of frames in memory, [n, h, w] grey of 8 bit, as ``reconstruct`` makes them of a file (median 0)."""
    fold = Fold(frames.shape[1:], bit_depth=8, edge="rising", frames_expected=len(frames))
    for index, frame in enumerate(frames):
        fold.add(index, frame)
    live: Literal["linear", "probit"] = "linear" if method == "linear" else "probit"
    maps = fold.result(contrast=contrast, median=0, method=live, noise_counts=noise_counts, read_columns=None)
    if method == "linear":
        return maps
    sequence = FrameSequence(columns_of_stack(frames), fold.present, "rising", 8)
    return filtered(refine(maps, method, sequence, noise_counts).maps)


def bench_estimates(
    pixels: int = 16_000,
    widths: Series[float] = WIDTHS,
    levels: Series[tuple[float, float]] = LEVELS,
    methods: Series[Method] = METHODS,
) -> Iterator[Case]:
    """Every method on every kind of edge, in turn."""
    for width in widths:
        for contrast, noise in levels:
            frames = made_edges(width, contrast, noise, pixels)
            for method in methods:
                yield _case(frames, width, contrast, noise, method, FLAGGED)


def bench_clipped(pixels: int = 16_000) -> Iterator[Case]:
    """Edges whose plateau is beyond full scale; the flag for saturation is expected and not counted."""
    for width in CLIPPED_WIDTHS:
        for contrast, noise in CLIPPED_LEVELS:
            frames = made_edges(width, contrast, noise, pixels)
            for method in METHODS:
                yield _case(frames, width, contrast, noise, method, FLAGGED & ~int(Quality.SATURATED))


def _case(frames: NDArray[np.uint8], width: float, contrast: float, noise: float, method: Method, flagged: int) -> Case:
    maps = estimated(frames, method, round(contrast / 2), noise)
    error = maps.crossing.ravel() - true_crossing(maps.crossing.size)
    phase = np.arange(error.size) % PHASES
    bound = crossing_bound(width, contrast, noise, np.arange(PHASES) / PHASES)
    good = np.isfinite(error) & ((maps.quality.ravel() & flagged) == 0)
    if not good.any():
        return Case(width, contrast, noise, method, math.nan, math.nan, math.nan, math.nan, 0.0)
    in_sigma = np.abs(error[good]) / maps.sigma.ravel()[good]
    bias = np.array([error[good & (phase == k)].mean() for k in range(PHASES) if (good & (phase == k)).any()])
    return Case(
        width,
        contrast,
        noise,
        method,
        times_bound=float(np.sqrt(np.mean((error / bound[phase])[good] ** 2))),
        worst_bias=float(np.abs(bias).max() / max(0.02, 0.1 * float(bound.mean()))),
        within_68=float(np.mean(in_sigma <= 1.0)),
        within_95=float(np.mean(in_sigma <= 1.96)),
        unflagged=float(good.mean()),
    )


def markdown(cases: Series[Case]) -> str:
    """The cases as a table for the documentation."""
    head = "| w | contrast | noise | method | x bound | bias / allowed | in 1 sigma | in 1.96 sigma | unflagged |"
    rows = [
        f"| {c.width:g} | {c.contrast:g} | {c.noise:g} | {c.method} | {c.times_bound:.2f} | {c.worst_bias:.2f} "
        f"| {c.within_68:.3f} | {c.within_95:.3f} | {c.unflagged:.4f} |"
        for c in cases
    ]
    return "\n".join([head, "| --- " * 9 + "|", *rows])


def bench_fit_speed(shape: tuple[int, int] = (768, 1024), frames: int = 527) -> dict[str, float]:
    """Seconds that ``auto`` takes after the two-sample estimate, for all pixels and for a tenth, frames in memory.

    processor: of all threads together, which tells more than the clock on a machine that does other things too.
    """
    height, width = shape
    rng = np.random.default_rng(2)
    place = (np.linspace(0.15, 0.85, width) * frames)[None, :] + np.zeros((height, 1))
    stack = np.empty((frames, height, width), np.uint8)
    noise = rng.normal(0, 2, 4 * height * width).astype(np.float32)
    for k in range(frames):
        z = np.clip((k - place[0]) / 4.0, -5, 5)
        level = (DARK + 60 * np.vectorize(math.erfc)(-z / math.sqrt(2))).astype(np.float32)
        start = int(rng.integers(0, 3 * height * width))
        stack[k] = np.rint(level + noise[start : start + height * width].reshape(shape))
    fold = Fold(shape, bit_depth=8, edge="rising", frames_expected=frames)
    for index, frame in enumerate(stack):
        fold.add(index, frame, keep=True)
    maps = fold.result(contrast=70, median=5, method="probit", noise_counts=2.0, read_columns=None)
    sequence = FrameSequence(columns_of_stack(stack), fold.present, "rising", 8)
    some = np.full(shape, np.nan)
    chosen = slice(height // 2, height // 2 + max(1, height // 10))
    some[chosen] = maps.crossing[chosen]
    seconds: dict[str, float] = {}
    for name, crossing in (("tenth", some), ("all", maps.crossing)):
        given = replace(maps, crossing=crossing)
        start_s, start_cpu_s = time.perf_counter(), time.process_time()
        refine(given, "auto", sequence, 2.0)
        seconds |= {
            f"{name}_pixels": float(np.isfinite(crossing).sum()),
            f"{name}_s": time.perf_counter() - start_s,
            f"{name}_processor_s": time.process_time() - start_cpu_s,
        }
    return seconds
