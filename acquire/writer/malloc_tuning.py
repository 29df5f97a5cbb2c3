"""Owns what becomes of the writer's freed memory: a bounded part of it is kept for the next frames.

By default the C library gives it back to the kernel, which clears the pages again for each frame that comes.
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
    """Ask the C library of this process for it; False where it is none that can (only glibc can)."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    return mallopt is not None and bool(
        mallopt(_MMAP_THRESHOLD, LARGEST_BYTES) and mallopt(_TRIM_THRESHOLD, KEPT_BYTES)
    )
