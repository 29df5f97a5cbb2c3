"""The points of a sweep that still runs, and which of them may still move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from process.cloud.cloud import PointCloud
from process.crossings.maps import Maps
from process.results.final_maps import cloud_of, maps_of
from process.results.fold_cursor import FoldCursor
from process.results.settings import Settings

SETTLED_AFTER_FRAMES = 20
"""A point counts as settled when its pixel has not got brighter for so many frames."""


@dataclass(frozen=True)
class PointCounts:
    """Numbers of pixels and points for the progress message."""

    over_contrast: int = 0
    settled: int = 0
    provisional: int = 0


@dataclass(frozen=True)
class ProvisionalCloud:
    """Points and maps of the frames folded so far."""

    maps: Maps
    cloud: PointCloud | None
    """None without a light plane."""
    provisional: NDArray[np.bool_]
    """[n], True while the point's pixel may still get brighter."""

    @property
    def counts(self) -> PointCounts:
        """Settled and provisional points, and pixels over the contrast."""
        moving = int(self.provisional.sum())
        return PointCounts(self.maps.counts["over_contrast"], len(self.provisional) - moving, moving)


def provisional_cloud(cursor: FoldCursor, settings: Settings, position_um: NDArray[np.float64]) -> ProvisionalCloud:
    """The points of the frames folded so far (at least one); the fold can go on afterwards.

    Pixels that need the scan file are left to the end.
    """
    maps = maps_of(cursor.fold, settings)
    cloud = cloud_of(maps, settings, cursor.folded, position_um)
    provisional = np.zeros(0, np.bool_)
    if cloud is not None:
        age = cursor.fold.folded_through - maps.last_maximum.ravel()[cloud.pixels]
        provisional = (age < SETTLED_AFTER_FRAMES) & (not cursor.done)
    return ProvisionalCloud(maps, cloud, provisional)
