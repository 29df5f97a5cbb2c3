"""The point cloud: which pixels become points, and in which order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from process.crossings.maps import Maps
from process.crossings.quality import Quality

from .light_planes import PlaneTable
from .ply import VERTEX, point_records
from .triangulation import F8, Hits, Rays, intersect

LEFT_OUT = int(Quality.LIT_AT_START | Quality.PLATEAU_NOT_REACHED | Quality.FILTERED)
"""Quality bits that keep a pixel out of the default cloud."""


@dataclass(frozen=True)
class PointCloud:
    """Points in row-major order of their pixels."""

    points_mm: F8
    """[n, 3] in full precision; files hold float32."""
    rgb: NDArray[np.uint8]
    """[n, 3]."""
    sigma_um: NDArray[np.float32]
    """[n], standard deviation along the ray."""
    crossing: F8
    """[n], fractional 0-based frame index."""
    quality: NDArray[np.uint16]
    """[n], ``Quality`` bits."""
    pixels: NDArray[np.intp]
    """[n], flat indices into the image, increasing."""

    def __len__(self) -> int:
        return len(self.pixels)

    @property
    def xyz(self) -> NDArray[np.float32]:
        """[n, 3] in mm as they stand in cloud.ply."""
        return self.points_mm.astype(np.float32)

    def vertices(self) -> NDArray[Any]:
        """Records of :data:`VERTEX`, [n]."""
        return point_records(
            VERTEX,
            self.points_mm,
            self.rgb,
            sigma_um=self.sigma_um,
            crossing=self.crossing,
            quality=self.quality,
        )


def make_cloud(maps: Maps, rays: Rays, table: PlaneTable, frame_t: F8, left_out: int = LEFT_OUT) -> PointCloud:
    """Points of all pixels that have a crossing, none of the quality bits ``left_out``, and a plane at their crossing.

    Args:
        maps: of the fold, [h, w].
        rays: of the whole image (``triangulation.rays``).
        table: the light plane (``triangulation.plane_table``).
        frame_t: sweep coordinate of each frame index (``triangulation.coordinates``).
        left_out: quality bits that keep a pixel out; 0 keeps all.
    """
    crossing, quality = maps.crossing.ravel(), maps.quality.ravel()
    wanted = np.isfinite(crossing)
    wanted &= (quality & left_out) == 0
    pixels = np.flatnonzero(wanted)
    hits = Hits(pixels, crossing[pixels], maps.sigma.ravel()[pixels])
    points, sigma_um = intersect(rays, table, frame_t, hits)
    met = np.isfinite(points[:, 0])
    pixels = pixels[met]
    return PointCloud(
        points_mm=points[met],
        rgb=maps.colour.reshape(-1, 3)[pixels],
        sigma_um=sigma_um[met].astype(np.float32),
        crossing=hits.crossing[met],
        quality=quality[pixels],
        pixels=pixels,
    )
