"""Compilation of the kernels with numba: without the interpreter lock, cached under the digest of all their sources.

numba's cache notices a change of the file that a kernel is defined in, but not of a file that it calls into. A stale
mixture of the two would write past its arrays, hence one cache folder per digest. A kernel's file that is added or
renamed goes into SOURCES; the Makefile's $(KERNELS) rule finds it by its folder.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from numba import config, njit

SOURCES = (
    "numba_cache",
    "simd",
    "pixel_layout",
    "fold/maxima_log",
    "fold/kernels",
    "crossings/quality",
    "crossings/two_sample_kernels",
    "fold/colour",
    "edge_fit/initial_guess",
    "edge_fit/erf_fit_kernels",
    "edge_fit/pixel_kernels",
    "edge_fit/noise_model",
    "edge_fit/pixel_columns",
    "edge_fit/weighting",
    "edge_fit/filters",
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
"""Decorator of a part of kernels that is too small for a call of its own."""
