"""Owns the way to single pixels of a scan: their levels over a stretch of frames, gathered out of all frames at once.

Promises the same levels as those of the whole frames, whatever part of them is asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from process.numba_cache import kernel

ReadColumns: TypeAlias = Callable[[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]], NDArray[Any]]
"""(flat pixel indices [p], first and end place of each among the folded frames [p]) -> original grey levels
[p, longest stretch]; row i holds the places first[i] .. end[i] - 1 from its beginning, what follows has no meaning."""


FRAMES_AT_ONCE = 16
"""Frames gone through together: one cache line of each is at hand while neighbouring pixels are read."""


@kernel
def gather(frames, indices, pixels, first, end, out):
    """Copy frames [n, pixels, channels] at places first[i] .. end[i] - 1 of pixels[i] into out [p, longest, channels].

    indices: frame of each place. Neighbouring pixels share cache lines, if they follow each other.
    """
    channels = frames.shape[2]
    for begin in range(first.min(), end.max(), FRAMES_AT_ONCE):
        for i in range(pixels.size):
            pixel, origin = pixels[i], first[i]
            for place in range(max(origin, begin), min(end[i], begin + FRAMES_AT_ONCE)):
                if channels == 1:
                    out[i, place - origin, 0] = frames[indices[place], pixel, 0]
                else:
                    for channel in range(3):
                        out[i, place - origin, channel] = frames[indices[place], pixel, channel]


def gathered(
    frames: NDArray[Any],
    indices: NDArray[np.int64],
    pixels: NDArray[np.int64],
    first: NDArray[np.int64],
    end: NDArray[np.int64],
) -> NDArray[Any]:
    """Stored values of some pixels, [p, longest, channels]; frames [n, h * w, 1 or 3], read-only use.

    See :data:`ReadColumns`; indices [places]: index into frames of each folded frame.
    """
    out = np.empty((len(pixels), int((end - first).max(initial=0)), frames.shape[2]), frames.dtype)
    if out.size:
        gather(frames, indices, pixels, first, end, out)
    return out


def columns_of_stack(stack: NDArray[Any]) -> ReadColumns:
    """Columns of grey frames in memory, [n, h, w], all of them folded."""
    frames = stack.reshape(len(stack), -1, 1).view()
    frames.flags.writeable = False
    indices = np.arange(len(stack))

    def read(pixels: NDArray[np.int64], first: NDArray[np.int64], end: NDArray[np.int64]) -> NDArray[Any]:
        return gathered(frames, indices, pixels, first, end).reshape(len(pixels), -1)

    return read
