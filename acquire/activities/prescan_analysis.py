"""Bounds and exposure of a sweep from the pictures of a pre-scan. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from .exposure_search import TARGET

FEW: Final = 0.002
"""Share of the specimen's pixels that may be outliers: noise and glints."""
LEAST_PIXELS: Final = 4
WIDEST_PX: Final = 256
"""Pictures are kept at most so wide: bounds need no more, and all are analysed in one turn of the daemon's loop."""
WARN_SHARE: Final = 0.005
"""Share of the specimen from which on light at the wrong end causes a warning."""
RISEN: Final = 0.1
DONE: Final = 0.9
"""Shares of a pixel's range at which the light begins to arrive, and has arrived."""
CLIPPED: Final = 0.998
"""From this share of full scale on the percentile is saturated."""
_GUESS: Final = 0.5
"""Factor for the exposure of saturated pictures, whose brightness is unknown."""


@dataclass
class PrescanPictures:
    """Reduced grey pictures, one for each position, and the highest brightness at full size."""

    positions: list[int] = field(default_factory=list)
    pictures: list[NDArray[np.uint8]] = field(default_factory=list)
    high: float = 0.0
    """Highest 99.9th percentile of any picture, as a share of full scale."""
    full_scale_share: float = 0.0
    """Largest share of a picture's pixels at full scale."""

    def add(self, position_steps: int, picture: NDArray[np.uint8], high: float, full_scale_share: float) -> None:
        """Add a picture: [h, w] grey or [h, w, 3] RGB, uint8, at most some hundred pixels wide."""
        grey: NDArray[Any] = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) if picture.ndim == 3 else picture
        if grey.shape[1] > WIDEST_PX:
            height = max(1, round(grey.shape[0] * WIDEST_PX / grey.shape[1]))
            grey = cv2.resize(grey, (WIDEST_PX, height), interpolation=cv2.INTER_AREA)
        self.positions.append(position_steps)
        self.pictures.append(grey.astype(np.uint8, copy=False))
        self.high = max(self.high, high)
        self.full_scale_share = max(self.full_scale_share, full_scale_share)


@dataclass(frozen=True)
class Bounds:
    """Proposed first and last position of a sweep."""

    first_steps: int
    last_steps: int
    brightest_steps: int
    """Position where most of the specimen is lit, for setting the exposure."""
    warnings: tuple[str, ...]


def find_bounds(taken: PrescanPictures, contrast: float, travel: tuple[int, int]) -> Bounds:
    """Begin and end of the sweep: one position before the light reaches the specimen and after it has passed.

    The specimen is every pixel whose range reaches ``contrast`` (8-bit counts). Bounds lie within ``travel``.
    """
    positions, pictures = taken.positions, np.stack(taken.pictures)
    low, high = pictures.min(axis=0), pictures.max(axis=0)
    mask = cv2.medianBlur(((high - low) >= contrast).astype(np.uint8), 3) > 0
    if np.count_nonzero(mask) < LEAST_PIXELS:
        middle = positions[int(pictures.reshape(len(positions), -1).mean(axis=1).argmax())]
        what = f"no pixel changes by {contrast:g} counts: is there a specimen, and does the light reach it?"
        return Bounds(positions[0], positions[-1], middle, (what,))
    risen, done, lit = _lighting(pictures[:, mask].astype(np.float32))
    # pixels that are lit in all pictures do not change, and are no darker than those that are lit later
    always = np.count_nonzero(low >= np.median((low[mask].astype(np.float32) + high[mask]) / 2))
    lit_at_first = (np.count_nonzero(lit[0]) + always) / (lit.shape[1] + always)
    begin, end = (_quantile(risen, FEW), _quantile(done, 1 - FEW))
    pitch = positions[1] - positions[0] if len(positions) > 1 else 0
    last = len(positions) - 1
    return Bounds(
        first_steps=_within(positions[max(begin - 1, 0)] - pitch, travel),
        last_steps=_within(positions[end] + pitch, travel),
        brightest_steps=positions[int(lit.sum(axis=1).argmax())],
        warnings=tuple(_at_the_ends(lit_at_first, float((done == last).mean()), positions)),
    )


def propose_exposure(
    taken: PrescanPictures, exposure_ms: float, black: float, bounds_ms: Sequence[float]
) -> tuple[float, str]:
    """The exposure that brings the brightest picture to the target, in ms, and a warning (empty: none).

    ``black`` is the black level as a share of full scale; the pictures were taken with ``exposure_ms``.
    """
    shortest, longest = bounds_ms
    if taken.high >= CLIPPED:
        share = 100 * taken.full_scale_share
        warning = (
            f"up to {share:.1f} % of the picture is saturated at {exposure_ms:.3g} ms: "
            "search the exposure where the light is on the specimen"
        )
        return max(exposure_ms * _GUESS, shortest), warning
    wanted_ms = exposure_ms * (TARGET - black) / max(taken.high - black, 1e-3)
    if wanted_ms <= longest:
        return max(wanted_ms, shortest), ""
    return longest, f"it stays dark: {wanted_ms:.3g} ms would be right, {longest:.3g} ms is the longest; raise the gain"


def _lighting(seen: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """For each pixel [n] the pictures in which light begins to arrive, and has; [pictures, n] where it is lit."""
    low, high = seen.min(axis=0), seen.max(axis=0)
    risen = (seen >= low + RISEN * (high - low)).argmax(axis=0)
    done = (seen >= low + DONE * (high - low)).argmax(axis=0)
    return risen, done, 2 * seen >= low + high


def _quantile(numbers: NDArray[np.int64], share: float) -> int:
    return int(np.quantile(numbers, share, method="nearest"))


def _within(position_steps: int, travel: tuple[int, int]) -> int:
    return min(max(position_steps, travel[0]), travel[1])


def _at_the_ends(lit_at_first: float, late_at_last: float, positions: Sequence[int]) -> list[str]:
    found = []
    if lit_at_first > WARN_SHARE:
        found.append(
            f"{100 * lit_at_first:.1f} % of the specimen is lit in the first picture, at {positions[0]}: begin outside"
        )
    if late_at_last > WARN_SHARE:
        found.append(
            f"{100 * late_at_last:.1f} % of the specimen is dark until the last picture, at {positions[-1]}: end later"
        )
    return found
