"""Own how kernels are compiled: without the interpreter lock, and cached under the digest of all their sources.

numba's cache notices a change of the file that a kernel stands in, but not of a file that it calls into;
a stale mixture of the two would write past its arrays. Hence a cache folder per digest.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from numba import config, njit

SOURCES = (
    "compiled",
    "vector_blocks",
    "tiles",
    "record_log",
    "fold_kernels",
    "quality",
    "crossing_kernels",
    "colour",
    "estimates/edge_start",
    "estimates/edge_kernels",
    "estimates/block_kernels",
    "estimates/noise",
    "estimates/columns",
    "estimates/weighing",
    "estimates/filters",
)
"""Modules of this package whose code or constants end up in kernels."""

_HERE = Path(__file__).parent


def source_digest() -> str:
    """Short sha256 over the kernels' sources."""
    digest = hashlib.sha256()
    for name in SOURCES:
        digest.update((_HERE / f"{name}.py").read_bytes())
    return digest.hexdigest()[:16]


# Where this folder cannot be written, numba falls back to its own one in the home directory.
config.CACHE_DIR = str(_HERE / "__pycache__" / f"kernels-{source_digest()}")  # type: ignore[attr-defined]

kernel: Any = njit(cache=True, nogil=True)
"""Decorator of a kernel."""

inlined_kernel: Any = njit(cache=True, nogil=True, inline="always")
"""Decorator of a piece of kernels that is worth no call."""
