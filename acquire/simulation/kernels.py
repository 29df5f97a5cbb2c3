"""The decorator of the simulation's kernels; see acquire.contract.process.kernel_cache."""

from __future__ import annotations

from pathlib import Path

from acquire.contract.process.kernel_cache import digest_of, kernel_decorator

SOURCES_DIGEST = digest_of(Path(__file__).parent.glob("*.py"))
"""Of all modules of this package."""

kernel = kernel_decorator(SOURCES_DIGEST)
