"""Owns the point cloud: which pixels become points, in which order, and how they stand in cloud.ply."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement

from process.atomic_write import replacing

from .triangulation import F8, Hits, PlaneTable, Rays, intersect

if TYPE_CHECKING:
    from process.crossings.maps import Maps

LEFT_OUT = 1 | 2 | 128
"""Quality bits that keep a pixel out of the default cloud: lit at the start, plateau not reached, filtered."""

VERTEX = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("sigma_um", "<f4"),
        ("crossing", "<f4"),
        ("quality", "<u2"),
    ]
)
"""One vertex of cloud.ply; mm, RGB, um, fractional 0-based frame index, quality bits."""


@dataclass(frozen=True)
class Cloud:
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
        found = np.empty(len(self), VERTEX)
        for axis, name in enumerate("xyz"):
            found[name] = self.points_mm[:, axis]
        for channel, name in enumerate(("red", "green", "blue")):
            found[name] = self.rgb[:, channel]
        found["sigma_um"], found["crossing"], found["quality"] = self.sigma_um, self.crossing, self.quality
        return found


def make_cloud(maps: Maps, rays: Rays, table: PlaneTable, frame_t: F8, left_out: int = LEFT_OUT) -> Cloud:
    """Points of all pixels that have a crossing, none of the quality bits ``left_out``, and a plane at their crossing.

    Args:
        maps: of the fold, [h, w].
        rays: of the whole image (``geometry.rays``).
        table: the light plane (``geometry.plane_table``).
        frame_t: sweep coordinate of each frame index (``geometry.coordinates``).
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
    return Cloud(
        points_mm=points[met],
        rgb=maps.colour.reshape(-1, 3)[pixels],
        sigma_um=sigma_um[met].astype(np.float32),
        crossing=hits.crossing[met],
        quality=quality[pixels],
        pixels=pixels,
    )


def write_ply(path: Path, cloud: Cloud) -> None:
    """Write ``cloud`` as binary little-endian PLY; the same cloud gives the same bytes.

    Raises:
        ResultWriteError: the folder cannot be written to.
    """
    element = PlyElement.describe(cloud.vertices(), "vertex")
    with replacing(path) as temporary:
        PlyData([element], byte_order="<").write(str(temporary))
