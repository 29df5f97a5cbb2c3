"""The light check: detects within two frames that the lamp dims or fails, or that the room became brighter.

Frames of a sweep differ only where the edge of the light passes: other lit pixels stay as bright, other dark pixels
stay as dark. When nearly all of them change at once, the light has changed.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

LAG_FRAMES: Final = 4
"""A frame is compared with the one so many frames before it, so that a lamp that fades slowly is detected, too."""
LARGEST_GAP_FRAMES: Final = 8
"""Frames that may be missing in between (lost, taken later); beyond that the edge of the light has moved too far."""
BRIGHT: Final = 0.2
"""Share of full scale above which a pixel counts as lit."""
DARK: Final = 0.12
SATURATED: Final = 0.98
LEAST_SHARE: Final = 0.02
"""Share of the pixels that must be lit (or dark) for a decision."""
STAYING_SHARE: Final = 0.75
"""Share of the lit pixels that must still have been lit one frame ago."""
RELATIVE_CHANGE: Final = 0.08
"""Change of nearly all lit pixels that is attributed to the lamp; noise of single pixels gives 0.03."""
ROOM_CHANGE: Final = 0.03
"""Rise of nearly all dark pixels, as a share of full scale, that is attributed to the room."""
NEARLY_ALL_PERCENT: Final = 90.0
_GRID: Final = 128


@dataclass
class LightMonitor:
    """Takes the frames of a sweep in order."""

    full_scale: int
    """Largest count."""
    _earlier: deque[NDArray[np.float32]] = field(default_factory=lambda: deque(maxlen=LAG_FRAMES))
    _next_index: int = -1
    _suspect: int | None = None

    def update(self, frame_index: int, pixels: NDArray[Any]) -> tuple[int, str] | None:
        """Check a frame: [h, w] or [h, w, 3], counts as stored.

        Returns:
            the first frame in another light and what changed, in words; None when nothing did. Two frames in a row
            must show it. Call :meth:`forget` to accept the new light.
        """
        if self._earlier and not 0 <= frame_index - self._next_index <= LARGEST_GAP_FRAMES:
            if 0 <= self._next_index - frame_index <= LAG_FRAMES:
                return None  # a retake: the frames after it were checked already
            self.forget()
        self._next_index = frame_index + 1
        seen = _sample(pixels) / np.float32(self.full_scale)
        changed = _change(self._earlier[0], self._earlier[-1], seen) if self._earlier else ""
        if not changed:
            self._earlier.append(seen)
            self._suspect = None
            return None
        if self._suspect is None:
            self._suspect = frame_index
            return None
        return self._suspect, changed

    def forget(self) -> None:
        """Start anew: the next frames are compared with each other only."""
        self._earlier.clear()
        self._suspect, self._next_index = None, -1


def _sample(pixels: NDArray[Any]) -> NDArray[np.float32]:
    step = max(1, pixels.shape[1] // _GRID)
    grey = pixels[::step, ::step, 1] if pixels.ndim == 3 else pixels[::step, ::step]
    return grey.astype(np.float32)


def _change(before: NDArray[np.float32], latest: NDArray[np.float32], now: NDArray[np.float32]) -> str:
    lit = (before > BRIGHT) & (before < SATURATED)
    # where the edge is about to leave the last lit pixels, their darkness is no sign of the lamp
    stays = np.count_nonzero(latest[lit] > BRIGHT) > STAYING_SHARE * np.count_nonzero(lit)
    if stays and np.count_nonzero(lit) > LEAST_SHARE * lit.size:
        low, high = np.percentile(now[lit] / before[lit], (100 - NEARLY_ALL_PERCENT, NEARLY_ALL_PERCENT)) - 1
        if high < -RELATIVE_CHANGE:
            return f"the lamp gives {-100 * high:.0f} % less light or fails"
        if low > RELATIVE_CHANGE:
            return f"there is {100 * low:.0f} % more light"
    dark = before < DARK
    if np.count_nonzero(dark) > LEAST_SHARE * dark.size:
        rise = float(np.percentile(now[dark] - before[dark], 100 - NEARLY_ALL_PERCENT))
        if rise > ROOM_CHANGE:
            return f"the room became brighter, by {100 * rise:.0f} % of full scale"
    return ""
