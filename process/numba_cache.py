"""The decorators of the kernels; see acquire.contract.process.kernel_cache."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from acquire.contract.process.kernel_cache import digest_of, kernel_decorator

_HERE = Path(__file__).parent
SOURCES = [_HERE / "simd.py", _HERE / "pixel_layout.py"] + [
    path for folder in ("fold", "crossings", "edge_fit", "cloud") for path in (_HERE / folder).glob("*.py")
]
"""Every module whose code or constants can end up in a kernel."""

SOURCES_DIGEST = digest_of(SOURCES)

kernel: Any = kernel_decorator(SOURCES_DIGEST)
"""Decorator of a kernel."""

inlined_kernel: Any = kernel_decorator(SOURCES_DIGEST, inline=True)
"""Decorator of a part of kernels that is too small for a call of its own."""
