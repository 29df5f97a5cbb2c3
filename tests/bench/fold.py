"""Measures the fold against memcpy, both over the same stream of distinct frames."""

from __future__ import annotations

from collections.abc import Callable
from math import erf, sqrt
from time import perf_counter_ns
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from process.fold.fold import Fold, level_type
from process.warmup import warm_up

LIT_SHARE = 0.1
"""Share of the pixels that the simulated object covers; the rest is dark with noise."""
EDGE_WIDTH_FRAMES = 3.0
"""Standard deviation of the light's edge, in frames."""
NOISE_8BIT = 2.5
"""Standard deviation of the noise, in counts of 8 bit."""
RING_BYTES = 120_000_000
"""Distinct frames made and timed in one go: at least 100 of 1024 x 768, more than a cache holds."""


class Format(NamedTuple):
    """A kind of frame to measure."""

    name: str
    bit_depth: int
    channels: int


FORMATS = (Format("mono_8", 8, 1), Format("mono_12", 12, 1), Format("rgb_8", 8, 3))


class SweepSimulator:
    """Cheap frames of a sweep of erf edges over a rectangle of lit object on a dark noisy ground."""

    def __init__(self, shape: tuple[int, int], frames: int, kind: Format) -> None:
        self._rng = np.random.default_rng(20)
        self._kind = kind
        height, width = shape
        rows, columns = (max(1, round(side * sqrt(LIT_SHARE))) for side in shape)
        top, left = (height - rows) // 2, (width - columns) // 2
        self._lit = (slice(top, top + rows), slice(left, left + columns))
        across = np.linspace(0.1, 0.8, columns, dtype=np.float32)[None, :]
        down = np.linspace(0, 0.1, rows, dtype=np.float32)[:, None]
        self._crossing = (across + down) * frames
        self._amplitude = self._rng.uniform(80, 220, (rows, columns)).astype(np.float32)
        self._ground = self._rng.uniform(8, 16, shape).astype(np.float32)
        self._noise = self._rng.normal(0, NOISE_8BIT, 4 * height * width + 1).astype(np.float32)
        grid = np.linspace(-5, 5, 2001)
        self._edge = (grid, np.array([0.5 + 0.5 * erf(x / sqrt(2)) for x in grid]))

    def frame(self, index: int) -> NDArray[Any]:
        """Frame `index`: [h, w] or [h, w, 3], uint8 or uint16."""
        image = self._ground.copy()
        phase = (index - self._crossing) / EDGE_WIDTH_FRAMES
        image[self._lit] += self._amplitude * np.interp(phase, *self._edge).astype(np.float32)
        start = int(self._rng.integers(0, self._noise.size - image.size))
        image += self._noise[start : start + image.size].reshape(image.shape)
        image *= 2 ** (self._kind.bit_depth - 8)
        levels = np.clip(np.rint(image), 0, 2**self._kind.bit_depth - 1).astype(level_type(self._kind.bit_depth))
        return levels if self._kind.channels == 1 else np.repeat(levels[:, :, None], 3, axis=2)


def bench_fold(
    shape: tuple[int, int] = (768, 1024), frames: int = 527, formats: tuple[Format, ...] = FORMATS
) -> dict[str, dict[str, float]]:
    """Milliseconds per frame of memcpy and of the whole fold, and their ratio, by format.

    shape: (height, width). Times cover a whole sweep, first frames and last flush included; making the
    frames is not timed. `copied` frames may be overwritten after add, `kept` ones stay where they are;
    `late_ratio` leaves the first fifth of the sweep out; `result_ms` is one result at the end.
    """
    warm_up()
    return {kind.name: _bench_format(shape, frames, kind) for kind in formats}


class _Stopwatch:
    """Nanoseconds of each frame of one way to handle them."""

    def __init__(self, frames: int, handle: Callable[[int, NDArray[Any]], None]) -> None:
        self.ns = np.zeros(frames)
        self._handle = handle

    def run(self, begin: int, chunk: NDArray[Any]) -> None:
        for index, frame in enumerate(chunk, begin):
            start = perf_counter_ns()
            self._handle(index, frame)
            self.ns[index] = perf_counter_ns() - start


def _bench_format(shape: tuple[int, int], frames: int, kind: Format) -> dict[str, float]:
    simulator = SweepSimulator(shape, frames, kind)
    copying, keeping = (Fold(shape, bit_depth=kind.bit_depth, edge="rising", frames_expected=frames) for _ in range(2))
    one = simulator.frame(0)
    target = np.zeros_like(one)
    memcpy = _Stopwatch(frames, lambda _, frame: np.copyto(target, frame))
    copied = _Stopwatch(frames, copying.add)
    kept = _Stopwatch(frames, lambda index, frame: keeping.add(index, frame, keep=True))
    size = min(frames, max(1, RING_BYTES // one.nbytes))
    for begin in range(0, frames, size):
        chunk = np.stack([simulator.frame(k) for k in range(begin, min(begin + size, frames))])
        for stopwatch in (memcpy, copied, kept):
            stopwatch.run(begin, chunk)
    start = perf_counter_ns()
    keeping.result(contrast=70, median=5, noise_counts=2.0, read_columns=None)
    result_ns = perf_counter_ns() - start
    return {
        "frames": frames,
        "memcpy_ms": float(memcpy.ns.mean() / 1e6),
        **_figures("copied", copied.ns, memcpy.ns),
        **_figures("kept", kept.ns, memcpy.ns),
        "result_ms": result_ns / 1e6,
        "fold_bytes": Fold.bytes_needed(shape, kind.bit_depth),
    }


def _figures(name: str, fold_ns: NDArray[np.float64], memcpy_ns: NDArray[np.float64]) -> dict[str, float]:
    late = slice(len(fold_ns) // 5, None)
    return {
        f"{name}_ms": float(fold_ns.mean() / 1e6),
        f"{name}_ratio": float(fold_ns.mean() / memcpy_ns.mean()),
        f"{name}_late_ratio": float(fold_ns[late].mean() / memcpy_ns[late].mean()),
    }
