"""Is the rig still where it was? Compares a frame taken again after an interruption with the stored one.

The difference of the two frames is explained, to first order, by a few small causes, each with its own picture:
the stage stands elsewhere (the light edge moved along the sweep: the difference of two neighbouring stored frames),
the specimen moved in the image (the image's gradients), the light changed (the image itself). A linear least-squares
fit of all pixels finds how much of each there is; noise averages out, so shifts far below a pixel and a microstep
can be told from none. Frames are smoothed first, because noise in the pictures of the causes would hide them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.sweep.settings import OverlapLimits

SMOOTHING_PX = 2.0
"""Standard deviation of the Gaussian over which noise is averaged, in pixels."""


@dataclass(frozen=True)
class Overlap:
    """What the comparison found."""

    stage_steps: float | None
    """Microsteps that the light stands further along the sweep; None where frame 0 has no neighbour to compare."""
    specimen_px: float
    """Shift of the specimen in the image in pixels."""
    brightness: float
    """Relative change."""
    rms_counts: float
    """Root mean square of the difference, in counts as stored, after smoothing."""

    def as_checks(self) -> dict[str, float]:
        """The figures by the names that the report gives them."""
        found = {
            "overlap_specimen_px": self.specimen_px,
            "overlap_brightness_change": self.brightness,
            "overlap_rms_counts": self.rms_counts,
        }
        return found if self.stage_steps is None else found | {"overlap_stage_steps": self.stage_steps}

    def complaint(self, limits: OverlapLimits) -> str:
        """Why the sweep must not go on, in words; empty when it may."""
        if self.stage_steps is not None and abs(self.stage_steps) > limits.stage_steps:
            return f"the light stands {self.stage_steps:+.1f} microsteps from where it was"
        if self.specimen_px > limits.specimen_px:
            return f"the specimen moved by {self.specimen_px:.2f} pixels"
        if abs(self.brightness) > limits.brightness:
            return f"the light changed by {100 * self.brightness:+.0f} %"
        return ""


def compare_overlap(
    stored: NDArray[Any], retaken: NDArray[Any], before: NDArray[Any] | None, pitch_steps: int
) -> Overlap:
    """Compare a frame with its stored self.

    Args:
        stored: [h, w] or [h, w, 3], the last committed frame.
        retaken: the same frame taken again, same shape and type.
        before: the stored frame one pitch before it; None for frame 0.
        pitch_steps: signed microsteps from one frame to the next.
    """
    old, new = _smooth(stored), _smooth(retaken)
    gradient_y, gradient_x = np.gradient(old)
    causes: list[NDArray[np.float64]] = [old, np.asarray(gradient_x), np.asarray(gradient_y)]
    if before is not None:
        causes.append(old - _smooth(before))
    amounts = _explain(new - old, causes)
    return Overlap(
        stage_steps=None if before is None else float(amounts[3]) * abs(pitch_steps),
        specimen_px=float(np.hypot(amounts[1], amounts[2])),
        brightness=float(amounts[0]),
        rms_counts=float(np.sqrt(np.mean((new - old) ** 2))),
    )


def overlap_picture(stored: NDArray[Any], retaken: NDArray[Any]) -> NDArray[np.uint8]:
    """Stored, taken again, and their difference (x 8 about grey), side by side: uint8 [h, 3 w, 3] RGB."""
    old, new = _smooth(stored), _smooth(retaken)
    scale = 255 / max(float(old.max()), 1.0)
    difference = 128 + 8 * scale * (new - old)
    panes = np.concatenate([old * scale, new * scale, difference], axis=1)
    grey = np.clip(panes, 0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def _explain(difference: NDArray[np.float64], causes: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Least squares: how much of each cause is in the difference; a constant is allowed for."""
    matrix = np.stack([cause.ravel() for cause in causes] + [np.ones(difference.size)])
    amounts, *_ = np.linalg.lstsq(matrix @ matrix.T, matrix @ difference.ravel(), rcond=None)
    return np.asarray(amounts, dtype=np.float64)


def _smooth(frame: NDArray[Any]) -> NDArray[np.float64]:
    grey = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) if frame.ndim == 3 else frame
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), SMOOTHING_PX)
    return np.asarray(smooth, dtype=np.float64)
