"""Compares frame 0 with its repetition after the sweep: did the specimen or the light move meanwhile?"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def measure_drift(first: NDArray[Any], repeated: NDArray[Any]) -> dict[str, float]:
    """``drift_px`` (shift by phase correlation, pixels) and ``brightness_change`` (relative) between two frames.

    Args:
        first: [h, w] or [h, w, 3], any integer type.
        repeated: the same shape and type, taken at the same position after the sweep.
    """
    before, after = _grey(first), _grey(repeated)
    (shift_x, shift_y), _response = cv2.phaseCorrelate(before, after)
    mean = float(before.mean())
    change = (float(after.mean()) - mean) / mean if mean > 0 else 0.0
    return {"drift_px": float(np.hypot(shift_x, shift_y)), "brightness_change": change}


def _grey(frame: NDArray[Any]) -> NDArray[np.float32]:
    grey = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) if frame.ndim == 3 else frame
    return np.ascontiguousarray(grey, dtype=np.float32)
