"""Colour frames: their grey by OpenCV's weights, and the colour of each pixel, from the frame of its first maximum.

RGB frames [h, w, 3] and grey [h, w], uint8 or uint16 right-aligned; the colour kept is 8 bit. The maximum here is that
of the original intensity for both edges, not of the folded signal.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from process.fold.frame_buffer import writable
from process.fold.kernels import list_bits
from process.numba_cache import inlined_kernel, kernel
from process.pixel_layout import BLOCKS, TILE
from process.simd import BLOCK, GREY_BLOCK, GREY_WEIGHTS, grey_block, higher_than


@kernel
def grey_of_rgb(rgb, grey):
    """Grey [pixels] of rgb [pixels * 3], both uint8: the integers of OpenCV's COLOR_RGB2GRAY."""
    # whole blocks, then the rest by the same formula
    whole = grey.size - grey.size % GREY_BLOCK
    for at in range(0, whole, GREY_BLOCK):
        grey_block(rgb, 3 * at, grey, at)
    red, green, blue = GREY_WEIGHTS
    for pixel in range(whole, grey.size):
        at = 3 * pixel
        grey[pixel] = (red * rgb[at] + green * rgb[at + 1] + blue * rgb[at + 2] + (1 << 14)) >> 15


@inlined_kernel
def _take(pixel, grey, frame, highest, colour, shift):
    highest[pixel] = grey[pixel]
    for channel in range(3):
        colour[pixel, channel] = frame[pixel, channel] >> shift


@kernel
def take_new_maxima(grey, frame, highest, colour, shift):
    """Where grey [pixels] > highest [pixels]: set highest to it, and colour [pixels, 3] to frame >> shift."""
    masks = np.empty(BLOCKS, np.uint64)
    used = np.empty(BLOCKS + 1, np.uint64)
    listed = np.empty(TILE + 2, np.uint64)
    whole = grey.size - grey.size % TILE
    for start in range(0, whole, TILE):
        for block in range(BLOCKS):
            at = start + block * BLOCK
            masks[block] = higher_than(grey, at, highest, at)
        for index in range(list_bits(masks, used, listed)):
            # unsigned: numba would check a signed index for wrap-around
            _take(np.uint64(start) + listed[index], grey, frame, highest, colour, shift)
    for pixel in range(whole, grey.size):
        if grey[pixel] > highest[pixel]:
            _take(pixel, grey, frame, highest, colour, shift)


class ColourOfMaximum:
    """Running colour [h, w, 3] of the brightest original grey so far; the earlier frame wins a tie."""

    def __init__(self, shape: tuple[int, int], bit_depth: int) -> None:
        self._shift = bit_depth - 8
        self._highest: NDArray[Any] | None = None
        self._colour = np.zeros((shape[0] * shape[1], 3), np.uint8)
        self._shape = shape

    def add(self, grey: NDArray[Any], frame: NDArray[Any]) -> None:
        """Add a frame [h, w, 3] and its original grey [h, w]."""
        flat, pixels = np.ascontiguousarray(grey).reshape(-1), writable(np.ascontiguousarray(frame)).reshape(-1, 3)
        # the first frame is a maximum everywhere, also where it is 0
        if self._highest is None:
            self._highest = flat.copy()
            self._colour[:] = pixels >> self._shift
            return
        take_new_maxima(flat, pixels, self._highest, self._colour, self._shift)

    def copy(self) -> NDArray[np.uint8]:
        """Colours so far, [h, w, 3] uint8 RGB."""
        return self._colour.reshape(*self._shape, 3).copy()
