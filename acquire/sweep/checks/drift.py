"""The drift check: compares frame 0 with its repetition after the sweep."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

LEAST_RESPONSE = 0.05
"""Of the phase correlation; below this it has no clear peak: the frames have no structure in common."""


def measure_drift(first: NDArray[Any], repeated: NDArray[Any]) -> dict[str, float]:
    """Measure ``brightness_change`` (relative), and ``drift_px`` (shift, pixels) where the frames have structure.

    Args:
        first: [h, w] or [h, w, 3], any integer type.
        repeated: the same shape and type, taken at the same position after the sweep.
    """
    before, after = to_grey(first), to_grey(repeated)
    mean = float(before.mean())
    found = {"brightness_change": (float(after.mean()) - mean) / mean if mean > 0 else 0.0}
    if before.std() == 0 or after.std() == 0:
        return found
    window = cv2.createHanningWindow(before.shape[::-1], cv2.CV_32F)
    (shift_x, shift_y), response = cv2.phaseCorrelate(before, after, window)
    if response >= LEAST_RESPONSE:
        found["drift_px"] = float(np.hypot(shift_x, shift_y))
    return found


def to_grey(frame: NDArray[Any]) -> NDArray[np.float32]:
    """[h, w] or [h, w, 3] RGB, counts as stored, to grey [h, w]."""
    grey = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) if frame.ndim == 3 else frame
    return np.ascontiguousarray(grey, dtype=np.float32)
