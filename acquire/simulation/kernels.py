"""The decorator of the simulation's kernels (see acquire.contract.process.kernel_cache), and their array types."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from acquire.contract.process.kernel_cache import digest_of, kernel_decorator

F8: TypeAlias = NDArray[np.float64]
F4: TypeAlias = NDArray[np.float32]
Mask: TypeAlias = NDArray[np.bool_]
Bits: TypeAlias = NDArray[np.uint64]

SOURCES_DIGEST = digest_of(Path(__file__).parent.glob("*.py"))
"""Digest of all modules of this package."""

kernel = kernel_decorator(SOURCES_DIGEST)
