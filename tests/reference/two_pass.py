"""The two-pass definition of the maps (algorithms 1 to 3 of the paper): slow, obvious, plain numpy, pixel by pixel.

Independent of the fold on purpose: nothing of process is imported.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass
class Reference:
    minimum: np.ndarray
    maximum: np.ndarray
    mask: np.ndarray
    crossing: np.ndarray
    sigma: np.ndarray
    quality: np.ndarray
    colour: np.ndarray
    last_maximum: np.ndarray


def greys_of(frames: list[np.ndarray]) -> np.ndarray:
    grey = [f if f.ndim == 2 else cv2.cvtColor(f, cv2.COLOR_RGB2GRAY).reshape(f.shape[:2]) for f in frames]
    return np.stack(grey)


def two_pass(
    indices: list[int],
    frames: list[np.ndarray],
    *,
    bit_depth: int,
    edge: str,
    contrast: int,
    median: int,
    noise_counts: float,
) -> Reference:
    """indices: frame index of each present frame, ascending; frames [h, w] or [h, w, 3] RGB."""
    grey = greys_of(frames)
    minimum, maximum = grey.min(axis=0), grey.max(axis=0)
    wide = grey.astype(np.int64)
    mask = (wide.max(axis=0) - wide.min(axis=0) >= contrast * 2 ** (bit_depth - 8)).astype(np.uint8)
    if median > 1:
        mask = cv2.medianBlur(mask, median).reshape(mask.shape)
    signal = wide if edge == "rising" else 2**bit_depth - 1 - wide
    shape = minimum.shape
    crossing = np.full(shape, np.nan)
    sigma = np.full(shape, np.nan, np.float32)
    quality = np.zeros(shape, np.uint16)
    colour = np.zeros((*shape, 3), np.uint8)
    last_maximum = np.zeros(shape, np.int32)
    noise = noise_counts * 2 ** (bit_depth - 8)
    for y in range(shape[0]):
        for x in range(shape[1]):
            values = [int(v) for v in signal[:, y, x]]
            last_maximum[y, x] = indices[values.index(max(values))]
            brightest = frames[int(np.argmax(grey[:, y, x]))][y, x] >> (bit_depth - 8)
            colour[y, x] = brightest
            if not mask[y, x]:
                continue
            bits = 0
            if int(maximum[y, x]) == 2**bit_depth - 1:
                bits |= 8
            if int(minimum[y, x]) >= 2 ** (bit_depth - 1):
                bits |= 4
            t, s, more = estimate(indices, values, noise)
            crossing[y, x], sigma[y, x], quality[y, x] = t, s, bits | more
    return Reference(minimum, maximum, mask, crossing, sigma, quality, colour, last_maximum)


def estimate(indices: list[int], values: list[int], noise: float) -> tuple[float, float, int]:
    """Crossing, sigma and quality bits 1, 2, 4, 16, 64 of one pixel's folded signal."""
    low, high = min(values), max(values)
    if 2 * values[0] >= low + high:
        return np.nan, np.nan, 1
    at = next(k for k, value in enumerate(values) if 2 * value >= low + high)
    m, p = indices[at], indices[at - 1]
    after, before = values[at], values[at - 1]
    half = (low + high) / 2
    t = p + (m - p) * (half - before) / (after - before)
    f = (half - before) / (after - before)
    sigma = noise * np.sqrt(f**2 + (1 - f) ** 2) / (after - before) * (m - p)
    width = (high - low) / (2.5066 * (after - before) / (m - p))
    top = values.index(high)
    first, last = indices[0], indices[-1]
    bits = 0
    still_bright = 2 * min(values[top:]) >= low + high
    if still_bright and last - indices[top] <= width + 1 and last - t < 2.5 * width + 1:
        bits |= 2
    if t - first < 2.5 * width + 1:
        bits |= 4
    if dark_and_bright_again(values, at, top):
        bits |= 16
    if m - p > 1:
        bits |= 64
    return t, sigma, bits


def dark_and_bright_again(values: list[int], at: int, top: int) -> bool:
    """After frame `at`: down to a quarter of the height, then a new maximum, or up again by half of it."""
    low, high = min(values), max(values)

    def dark(value: int) -> bool:
        return 4 * value <= 3 * low + high

    if any(dark(value) for value in values[at : top + 1]):
        return True
    tail = values[top:]
    rise = max(value - min(tail[: k + 1]) for k, value in enumerate(tail))
    return dark(min(tail)) and 2 * rise >= high - low
