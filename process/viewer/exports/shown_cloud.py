"""What is shown at one moment, for the files that people take away: the points, how they are shown, and the numbers."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from process.cloud.ply import VERTEX, point_records, write_ply
from process.viewer.rig_client.tile import NO_POINTS, Tile, bounding_box_of, merged, power_of_two
from process.viewer.scene.camera_views import DEFAULT_BOUNDS
from process.viewer.stream.colouring import FittedPlane, Legend, ValueRange, ViewSettings, colours_of


@dataclass(frozen=True)
class ShownCloud:
    """The points, how they are shown, and the facts beside them."""

    title: str
    tiles: Mapping[int, Tile]
    settings: ViewSettings
    within: ValueRange | None
    plane: FittedPlane | None
    legend: Legend | None
    facts: Sequence[tuple[str, str]] = ()
    """Name and value: outcome, frames, settings, digest."""

    def thinned(self, most: int) -> Tile:
        """At most about ``most`` of the points that are shown, as one tile."""
        tiles = [tile for tile in self.tiles.values() if tile.count] or [NO_POINTS]
        x, y, z = (bounding_box_of(tiles) or DEFAULT_BOUNDS).centre
        one = merged(tiles, (float(x), float(y), float(z)))
        one = one if self.settings.box is None else one.inside(self.settings.box)
        return one.thinned(power_of_two(one.count, most))

    def colours(self, tile: Tile) -> NDArray[np.uint8]:
        """As on the page, shape [n, 3]."""
        return colours_of(tile, self.settings.mode, self.within, self.plane)


def ply_bytes(tiles: Mapping[int, Tile]) -> bytes:
    """All points as cloud.ply; while a scan is live their quality is not known, and 0."""
    parts = [np.zeros(0, VERTEX)]
    for tile in tiles.values():
        columns = {"sigma_um": tile.sigma_um, "crossing": tile.crossing}
        quality = tile.quality if tile.quality is not None else np.zeros(tile.count, np.uint16)
        parts.append(point_records(VERTEX, tile.points_mm(), tile.rgb, quality=quality, **columns))
    target = io.BytesIO()
    write_ply(target, np.concatenate(parts))
    return target.getvalue()
