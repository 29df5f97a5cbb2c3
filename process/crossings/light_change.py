"""Effects of a change of the light during a sweep: marked frames, and the pixels whose crossing depends on them."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .maps import Maps, quality_counts
from .quality import Quality


def marked(maps: Maps, other_light: NDArray[np.bool_]) -> Maps:
    """``maps`` with OTHER_LIGHT set where the crossing, or the maximum that S depends on, lies in a marked frame.

    Args:
        maps: of a whole sweep.
        other_light: ``ScanReader.other_light``, bool [frames].
    """
    if not other_light.any():
        return maps
    known = np.isfinite(maps.crossing)
    last = len(other_light) - 1
    # a crossing lies between two frames; the later one is the first in another light
    at = np.clip(np.ceil(np.where(known, maps.crossing, 0)).astype(np.int64), 0, last)
    depends_on_it = known & (other_light[at] | other_light[np.clip(maps.last_maximum, 0, last)])
    quality = maps.quality | np.where(depends_on_it, np.uint16(Quality.OTHER_LIGHT), np.uint16(0))
    counts = maps.counts | quality_counts(maps.mask, maps.crossing, quality)
    return dataclasses.replace(maps, quality=quality, counts=counts)


def light_warnings(other_light: NDArray[np.bool_], counts: dict[str, int]) -> list[str]:
    """Warnings for the report: one where frames were taken in another light."""
    frames = np.flatnonzero(other_light)
    if not frames.size:
        return []
    points = counts.get("other_light", 0)
    return [
        f"the light changed at frame {frames[0]}: {frames.size} frames from there on are marked, and {points} points "
        "that rest on them have the quality bit other_light"
    ]


def light_counts(other_light: NDArray[np.bool_]) -> dict[str, Any]:
    """``frames_other_light`` for the report."""
    return {"frames_other_light": int(np.count_nonzero(other_light))}
