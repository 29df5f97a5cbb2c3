"""The record of one point on the results lane; float32 about a tile's origin keeps steps well below 0.1 um."""

from __future__ import annotations

import numpy as np

POINT = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("provisional", "u1"),
        ("crossing", "<f4"),
        ("sigma_um", "<f4"),
    ]
)
"""x y z in mm about the tile's origin, colour, 1 while the pixel's maximum has not settled, crossing in frames."""
