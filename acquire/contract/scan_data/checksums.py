"""The checksum of a frame, and the digest of a scan over the checksums of its frames."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray


def frame_crc32(pixels: NDArray[Any] | bytes | memoryview) -> int:
    """crc32 (zlib's polynomial) of the stored bytes of one frame; the array must be C-contiguous."""
    return int(isal_zlib.crc32(pixels))


def scan_digest(crc32: NDArray[np.uint32]) -> str:
    """sha256 (hex) over the little-endian uint32 crc32 of frames 0..n-1 in order, missing = 0."""
    return hashlib.sha256(np.ascontiguousarray(crc32, dtype="<u4").tobytes()).hexdigest()
