"""The overlap check: compares a frame that was taken again after an interruption with the stored one.

To first order, the difference of the two frames is a sum of a few pictures, one for each cause: the stage moved (the
light edge moved along the sweep: the difference of two neighbouring stored frames), the specimen moved in the image
(the image's gradients), the light changed (the image itself). A linear least-squares fit over all pixels finds the
amount of each. Noise averages out, so shifts far below a pixel and a microstep are found. Frames are smoothed first:
noise in the pictures of the causes would bias the fit towards zero.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.sweep.settings import OverlapLimits

from .drift import to_grey

SMOOTHING_PX = 2.0
"""Standard deviation of the Gaussian that averages noise, in pixels."""


def compare_overlap(
    stored: NDArray[Any], retaken: NDArray[Any], before: NDArray[Any] | None, pitch_steps: int
) -> dict[str, float]:
    """Compare a frame with the stored one.

    Args:
        stored: [h, w] or [h, w, 3], the last committed frame.
        retaken: the same frame taken again, same shape and type.
        before: the stored frame one pitch before it; None for frame 0.
        pitch_steps: signed microsteps from one frame to the next.

    Returns:
        ``overlap_specimen_px`` (shift in the image, pixels), ``overlap_brightness_change`` (relative),
        ``overlap_rms_counts`` (RMS of the smoothed difference, counts as stored), and where there is a frame before,
        ``overlap_stage_steps`` (shift of the light along the sweep, microsteps).
    """
    old, new = _smooth(stored), _smooth(retaken)
    gradient_y, gradient_x = np.gradient(old)
    causes: list[NDArray[np.float64]] = [old, np.asarray(gradient_x), np.asarray(gradient_y)]
    if before is not None:
        causes.append(old - _smooth(before))
    amounts = _amounts(new - old, causes)
    found = {
        "overlap_specimen_px": float(np.hypot(amounts[1], amounts[2])),
        "overlap_brightness_change": float(amounts[0]),
        "overlap_rms_counts": float(np.sqrt(np.mean((new - old) ** 2))),
    }
    return found if before is None else found | {"overlap_stage_steps": float(amounts[3]) * abs(pitch_steps)}


def overlap_complaint(found: dict[str, float], limits: OverlapLimits) -> str:
    """Why the sweep must not go on, in words; empty when it may."""
    stage_steps = found.get("overlap_stage_steps", 0.0)
    if abs(stage_steps) > limits.stage_steps:
        return f"the light is {stage_steps:+.1f} microsteps from where it was"
    if found["overlap_specimen_px"] > limits.specimen_px:
        return f"the specimen moved by {found['overlap_specimen_px']:.2f} pixels"
    if abs(found["overlap_brightness_change"]) > limits.brightness:
        return f"the light changed by {100 * found['overlap_brightness_change']:+.0f} %"
    return ""


def overlap_picture(stored: NDArray[Any], retaken: NDArray[Any]) -> NDArray[np.uint8]:
    """Stored, taken again, and their difference (x 8 about grey), side by side: uint8 [h, 3 w, 3] RGB."""
    old, new = _smooth(stored), _smooth(retaken)
    scale = 255 / max(float(old.max()), 1.0)
    difference = 128 + 8 * scale * (new - old)
    panes = np.concatenate([old * scale, new * scale, difference], axis=1)
    grey = np.clip(panes, 0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def _amounts(difference: NDArray[np.float64], causes: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Least squares: the amount of each cause in the difference; the last one is that of a constant."""
    matrix = np.stack([cause.ravel() for cause in causes] + [np.ones(difference.size)])
    amounts, *_ = np.linalg.lstsq(matrix @ matrix.T, matrix @ difference.ravel(), rcond=None)
    return np.asarray(amounts, dtype=np.float64)


def _smooth(frame: NDArray[Any]) -> NDArray[np.float64]:
    return np.asarray(cv2.GaussianBlur(to_grey(frame), (0, 0), SMOOTHING_PX), dtype=np.float64)
