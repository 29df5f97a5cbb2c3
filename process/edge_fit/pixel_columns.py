"""Levels of single pixels over a range of frames, gathered from frames in memory or in a mapped file.

Stored levels, uint8 or uint16; places are numbers of frames among the folded ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from process.numba_cache import kernel

ReadColumns: TypeAlias = Callable[[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]], NDArray[Any]]
"""(flat pixel indices [p], first and end place of each [p]) -> original grey levels [p, longest range]; row i begins
with the places first[i] .. end[i] - 1, the rest of it has no meaning."""


FRAMES_AT_ONCE = 16
"""Frames read together: one cache line of each stays in the cache while neighbouring pixels are read."""


@kernel
def gather(frames, indices, pixels, first, end, out):
    """Copy frames [n, pixels, channels] at places first[i] .. end[i] - 1 of pixels[i] into out [p, longest, channels].

    indices: frame of each place.
    """
    channels = frames.shape[2]
    # pixels inside, a few frames outside: neighbouring pixels share the cache lines of these frames
    for begin in range(first.min(), end.max(), FRAMES_AT_ONCE):
        for i in range(pixels.size):
            pixel, origin = pixels[i], first[i]
            for place in range(max(origin, begin), min(end[i], begin + FRAMES_AT_ONCE)):
                # a constant count of channels in each branch: the inner copy is unrolled
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
    """Stored values of some pixels, [p, longest, channels], from frames [n, h * w, 1 or 3].

    indices [places]: index into frames of each folded frame; the others as in :data:`ReadColumns`.
    """
    out = np.empty((len(pixels), int((end - first).max(initial=0)), frames.shape[2]), frames.dtype)
    if out.size:
        gather(frames, indices, pixels, first, end, out)
    return out


def columns_of_stack(stack: NDArray[Any]) -> ReadColumns:
    """Reader of grey frames in memory, [n, h, w], all of them folded."""
    frames = stack.reshape(len(stack), -1, 1).view()
    frames.flags.writeable = False
    indices = np.arange(len(stack))

    def read(pixels: NDArray[np.int64], first: NDArray[np.int64], end: NDArray[np.int64]) -> NDArray[Any]:
        return gathered(frames, indices, pixels, first, end).reshape(len(pixels), -1)

    return read
