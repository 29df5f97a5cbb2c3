"""Reduces a camera frame to a small picture, and measures its brightness. Pure and quick."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.scan_data.bayer import BAYER

WIDEST_PX: Final = 512
"""Largest width of a preview picture."""
_MOST_AVERAGED: Final = 4
"""Frames that must shrink by more than this are subsampled first, for speed."""
_SAMPLES: Final = 200_000
"""About so many pixels are measured: whole rows, evenly spread."""


@dataclass(frozen=True)
class Brightness:
    """Brightness of a frame; of a colour frame, that of the brightest channel."""

    full_scale_share: float
    """Share of the pixels at full scale, 0..1."""
    low: float
    """1st percentile in 8-bit counts, 0..255."""
    high: float
    """99.9th percentile in 8-bit counts, 0..255."""


def measure(pixels: NDArray[Any], bit_depth: int) -> Brightness:
    """Brightness of a frame [h, w] or [h, w, 3], uint8 or uint16 right-aligned, from evenly spread rows.

    A Bayer frame is measured as it is: an odd distance between rows samples both kinds of rows.
    """
    step = max(1, pixels.shape[0] * pixels.shape[1] // _SAMPLES) | 1
    sample = np.ascontiguousarray(pixels[::step])
    if sample.ndim == 3:
        red, green, blue = cv2.split(sample)
        sample = cv2.max(cv2.max(red, green), blue)
    levels = 1 << bit_depth
    histogram = cv2.calcHist([sample], [0], None, [levels], [0, levels]).ravel()
    reached = np.cumsum(histogram, dtype=np.float64) / sample.size
    in_8_bit = 255 / (levels - 1)
    return Brightness(
        full_scale_share=float(histogram[-1] / sample.size),
        low=float(np.searchsorted(reached, 0.01) * in_8_bit),
        high=float(np.searchsorted(reached[:-1], 0.999) * in_8_bit),
    )


def reduce(pixels: NDArray[Any], frame_format: FrameFormat) -> NDArray[np.uint8]:
    """The frame as uint8 [h, w] or [h, w, 3] RGB, averaged by area to at most ``WIDEST_PX`` wide; a copy.

    It shrinks by a whole number, which is quick; the rest of rows and columns at the far edges is left out.
    """
    if frame_format.pixel_format in BAYER:
        pixels = _quarter(pixels, frame_format.pixel_format.removeprefix("bayer_"))
    shrink = -(-pixels.shape[1] // WIDEST_PX)
    if shrink > _MOST_AVERAGED:
        thin, shrink = -(-shrink // 2), 2
        pixels = np.ascontiguousarray(pixels[::thin, ::thin])
    size = max(1, pixels.shape[1] // shrink), max(1, pixels.shape[0] // shrink)
    whole = np.ascontiguousarray(pixels[: size[1] * shrink, : size[0] * shrink])
    small: NDArray[Any] = cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
    if small.dtype != np.uint8:
        small = small >> (frame_format.bit_depth - 8)
    return small.astype(np.uint8, copy=False)


def _quarter(raw: NDArray[Any], colours: str) -> NDArray[Any]:
    """RGB of half the size from a Bayer frame: each 2 x 2 cell becomes one pixel, its greens averaged."""
    height, width = raw.shape[0] // 2 * 2, raw.shape[1] // 2 * 2
    cells = [raw[row:height:2, column:width:2] for row in (0, 1) for column in (0, 1)]
    red, blue = cells[colours.index("r")], cells[colours.index("b")]
    greens = [cell for cell, colour in zip(cells, colours, strict=True) if colour == "g"]
    green = cv2.addWeighted(np.ascontiguousarray(greens[0]), 0.5, np.ascontiguousarray(greens[1]), 0.5, 0)
    return np.dstack((red, green, blue))


@dataclass(frozen=True)
class PreviewFrame:
    """A frame that may become a preview picture, and where it was taken."""

    pixels: NDArray[Any]
    position_steps: int
    position_um: float
    exposure_ms: float
    frame_index: int = -1
    scan_uid: str = ""
