"""The frames that wait to be folded and the one before them, in fixed slots or by reference.

Grey frames [h, w] of one type, uint8 or uint16. Beside each whole frame its last, incomplete tile is kept, padded to
TILE, so that the kernel reads every tile in the same way.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

from process.pixel_layout import TILE, aligned_zeros


def writable(flat: NDArray[Any]) -> NDArray[Any]:
    """The same memory as a writable array; it is never written.

    numba compiles a kernel once for writable and once for read-only arrays, and frames from sockets are read-only.
    """
    if flat.flags.writeable:
        return flat
    memory = (ctypes.c_ubyte * flat.nbytes).from_address(flat.ctypes.data)
    return np.ctypeslib.as_array(memory).view(flat.dtype)


class FrameBuffer:
    """At most `batch` waiting frames and the one before them."""

    def __init__(self, shape: tuple[int, int], dtype: np.dtype[Any], batch: int) -> None:
        self._batch = batch
        self._pixels = shape[0] * shape[1]
        self._slots = list(aligned_zeros((batch + 1, *shape), dtype))
        self._tails = aligned_zeros((batch + 1, TILE), dtype)
        self._tail_start = self._pixels - self._pixels % TILE
        self._count = 0
        self._flats: list[NDArray[Any]] = []
        self._tail_rows: list[NDArray[Any]] = []
        self._owners: list[NDArray[Any]] = []
        """The frames themselves: a writable view does not keep their memory alive."""

    @property
    def waiting(self) -> int:
        """Frames that wait to be folded, without the one before them."""
        return max(0, len(self._flats) - 1)

    @property
    def full(self) -> bool:
        """True if no further frame has room."""
        return self.waiting == self._batch

    def slot(self) -> NDArray[Any]:
        """Memory [h, w] for the next frame; the same object until the next append."""
        return self._slots[self._count % (self._batch + 1)]

    def append(self, grey: NDArray[Any]) -> None:
        """Add the next frame: the slot, or a C-contiguous frame [h, w] that is not changed any more."""
        flat = grey.reshape(-1)
        tail = self._tails[self._count % (self._batch + 1)]
        tail[: self._pixels - self._tail_start] = flat[self._tail_start :]
        self._flats.append(writable(flat))
        self._tail_rows.append(tail)
        self._owners.append(grey)
        self._count += 1

    def waiting_frames(self) -> tuple[tuple[NDArray[Any], ...], tuple[NDArray[Any], ...]]:
        """Flat frames and their last, incomplete tiles: the one before, then those that wait.

        Always batch + 1 of each, the newest repeated: numba compiles anew for each length of a tuple.
        """
        # the kernel folds only the waiting ones: what fills the tuple up is never read
        missing = self._batch + 1 - len(self._flats)
        return (
            tuple(self._flats + self._flats[-1:] * missing),
            tuple(self._tail_rows + self._tail_rows[-1:] * missing),
        )

    def clear(self) -> None:
        """Forget all but the newest frame, which is the one before the next."""
        del self._flats[:-1], self._tail_rows[:-1], self._owners[:-1]
