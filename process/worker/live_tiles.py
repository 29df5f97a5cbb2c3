"""The cloud as tiles of the image: which of them changed since they were sent, and their bytes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from acquire.contract.messaging.messages import TileHeader
from acquire.contract.messaging.point_record import POINT
from process.cloud.cloud import PointCloud
from process.cloud.ply import point_records

SIDE_PX = 64
MAX_TILES = 1024
"""Larger images get larger tiles, so that a browser never has more nodes than this."""
MOVED_FRAMES = 0.02
"""A crossing that moved by less is not worth sending: 0.2 um at the usual pitch, well below its sigma."""


class TileGrid:
    """The fixed division of an image into square tiles, numbered in row-major order."""

    def __init__(self, width: int, height: int) -> None:
        side = SIDE_PX
        while -(-width // side) * -(-height // side) > MAX_TILES:
            side *= 2
        self.side = side
        self.columns = -(-width // side)
        self.count = self.columns * -(-height // side)
        rows = np.arange(height)[:, None] // side * self.columns
        self._of_pixel = (rows + np.arange(width) // side).ravel().astype(np.uint16)

    def of(self, pixels: NDArray[np.intp]) -> NDArray[np.uint16]:
        """The tile of each flat pixel index."""
        return self._of_pixel[pixels]


class LiveTiles:
    """The tiles as they were sent to the subscribers of the results lane, and what changed since."""

    def __init__(self, width: int, height: int) -> None:
        self.grid = TileGrid(width, height)
        self._crossing = np.full(width * height, np.nan)
        self._provisional = np.zeros(width * height, np.uint8)
        self._counts = np.zeros(self.grid.count, np.int64)
        self._pixels: dict[int, NDArray[np.intp]] = {}
        self._sent: dict[int, tuple[TileHeader, bytes]] = {}

    def update(
        self, cloud: PointCloud, provisional: NDArray[np.bool_], *, everything: bool = False
    ) -> tuple[list[TileHeader], bytes]:
        """Headers and payload of the tiles that changed.

        Args:
            cloud: the points now.
            provisional: [n], True while a point's pixel may still get brighter.
            everything: also of the tiles that did not change, if they have or had points.
        """
        tile = self.grid.of(cloud.pixels)
        counts = np.bincount(tile, minlength=self.grid.count)
        moved = ~(np.abs(self._crossing[cloud.pixels] - cloud.crossing) <= MOVED_FRAMES)
        moved |= self._provisional[cloud.pixels] != provisional
        changed = counts != self._counts
        changed[tile[moved]] = True
        if everything:
            changed |= (counts > 0) | (self._counts > 0)
        self._counts = counts
        chosen = np.flatnonzero(changed[tile])
        chosen = chosen[np.argsort(tile[chosen], kind="stable")]
        ends = np.cumsum(counts[changed])
        for number, end in zip(np.flatnonzero(changed), ends, strict=True):
            self._replace(int(number), cloud, provisional, chosen[end - counts[number] : end])
        numbers = [int(number) for number in np.flatnonzero(changed)]
        return self._message(numbers)

    def snapshot(self) -> tuple[list[TileHeader], bytes]:
        """Headers and payload of all tiles that hold points, as they were last sent."""
        return self._message([number for number in sorted(self._sent) if self._sent[number][0].count])

    def _replace(self, number: int, cloud: PointCloud, provisional: NDArray[np.bool_], which: NDArray[np.intp]) -> None:
        old, pixels = self._pixels.get(number), cloud.pixels[which]
        if old is not None:
            self._crossing[old] = np.nan
        self._crossing[pixels] = cloud.crossing[which]
        self._provisional[pixels] = provisional[which]
        self._pixels[number] = pixels
        points = cloud.points_mm[which]
        origin = points.mean(axis=0) if len(which) else np.zeros(3)
        records = point_records(
            POINT,
            points - origin,
            cloud.rgb[which],
            provisional=provisional[which],
            crossing=cloud.crossing[which],
            sigma_um=cloud.sigma_um[which],
        )
        header = TileHeader(
            tile=number,
            count=len(which),
            provisional=int(provisional[which].sum()),
            origin_mm=(float(origin[0]), float(origin[1]), float(origin[2])),
        )
        self._sent[number] = (header, records.tobytes())

    def _message(self, numbers: list[int]) -> tuple[list[TileHeader], bytes]:
        found = [self._sent[number] for number in numbers]
        return [header for header, _ in found], b"".join(body for _, body in found)
