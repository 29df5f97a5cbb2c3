"""Tunes malloc: a bounded part of freed memory is kept for the next frames.

By default glibc returns it to the kernel, which then has to clear fresh pages for each frame.
"""

from __future__ import annotations

import ctypes
from typing import Final

_TRIM_THRESHOLD: Final = -1
_MMAP_THRESHOLD: Final = -3
KEPT_BYTES: Final = 64 * 2**20
"""Freed memory that is kept at most, by each thread that allocates; the bound of glibc's own heaps beside the first."""
LARGEST_BYTES: Final = 32 * 2**20
"""Frames up to this size are taken from it: the most that glibc allows."""


def keep_freed_memory() -> bool:
    """Set M_TRIM_THRESHOLD and M_TOP_PAD of this process; False if its C library is not glibc."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    return mallopt is not None and bool(
        mallopt(_MMAP_THRESHOLD, LARGEST_BYTES) and mallopt(_TRIM_THRESHOLD, KEPT_BYTES)
    )
