"""Memory layout of the fold: tiles of pixels, their running planes, and the log of new maxima.

Pixels are kept in tiles of TILE. The state of a tile is four planes (maximum, tail dip, tail rise, minimum) side by
side, which stay in the first-level cache while several frames are folded into them. Only a new maximum can be a
crossing; each is appended to its tile's log, so that memory is written in order instead of one cache line per pixel.
All pixels of a tile share the log's room.

Levels are of the folded signal: the original intensity for rising edges, its complement for falling ones.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from process.simd import BLOCK

TILE = 2048
"""Pixels per tile: a multiple of BLOCK, and small enough that an offset leaves the top bit of 16 free for GAP."""

BLOCKS = TILE // BLOCK

PLANES = 4
MAXIMUM, TAIL_DIP, TAIL_RISE, MINIMUM = range(PLANES)
"""Planes of a tile's state.

MAXIMUM: running maximum. TAIL_DIP: lowest value since that maximum. TAIL_RISE: largest rise above the running lowest
value since that maximum. MINIMUM: lowest value before that maximum. min(TAIL_DIP, MINIMUM) is Imin of algorithm 1.
"""

VALUE, BEFORE, DIP = range(3)
"""Columns of the log's levels: the new maximum, the frame before it, the lowest value since the maximum before."""

GAP = 0x8000
PIXEL = 0x7FFF
"""`where` of an entry: ordinal << 16 | GAP (an entry of this pixel was dropped just below) | offset in the tile."""

MAX_FRAMES = 65536
"""Ordinals have 16 bits."""

NEVER = -1
UNKNOWN = -2
"""In place of an ordinal: no frame reaches S, or the log no longer knows which."""

OUT_OF_REACH = 4 * 65536
"""Above twice every level."""

NO_DIP = 65536
"""later_dip where no new maximum follows the crossing; above every level."""


class MaximaLog(NamedTuple):
    """The new maxima of all pixels, by tile, in the order of the frames."""

    where: NDArray[np.uint32]
    """[tiles, room], see PIXEL."""
    levels: NDArray[np.uint8] | NDArray[np.uint16]
    """[tiles, room, 3]: VALUE, BEFORE, DIP."""
    entries: NDArray[np.int64]
    """[tiles], entries in use."""
    lost_low: NDArray[np.uint8] | NDArray[np.uint16]
    """[tiles, TILE], highest value that was dropped as being below S; 0 for none."""


class LoggedCrossings(NamedTuple):
    """What the log knows of each pixel's crossing, flat over [tiles * TILE]."""

    ordinal: NDArray[np.int32]
    """First frame at or above S as its number among the folded frames, NEVER or UNKNOWN."""
    level: NDArray[np.uint16]
    """Value in that frame, I[m]."""
    before: NDArray[np.uint16]
    """Value in the folded frame before it, I[p]."""
    later_dip: NDArray[np.int32]
    """Lowest value between it and the last new maximum; NO_DIP where there is no later one."""
    last_ordinal: NDArray[np.int32]
    """Newest new maximum; 0 (the first frame) where none followed."""


def aligned_zeros(shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """Zeros that start on a cache line, every page touched now: page faults must not delay the first frames."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    raw = np.empty(size + 64, np.uint8)
    raw[:] = 0
    start = -raw.ctypes.data % 64
    return raw[start : start + size].view(dtype).reshape(shape)
