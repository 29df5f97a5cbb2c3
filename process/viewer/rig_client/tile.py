"""The points of result tiles as arrays ready to draw: checked, thinned evenly, clipped. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ProtocolError
from acquire.contract.messaging.messages import ResultTiles
from acquire.contract.messaging.point_record import POINT

GOLDEN = 0.6180339887498949
"""Fractional part of the golden ratio: multiples of it fill [0, 1) evenly and never fall in step with image rows."""
SMALL_SHARE = 0.03
SMALL_FLIPS = 0.15
SMALL_MOVE = 0.25
"""In units of the distance of neighbours."""
BOUNDS_SAMPLE = 512
BOUNDS_QUANTILES = (0.02, 0.98)
"""A few stray points must not move the camera away from the object."""
COLUMNS = ("xyz", "rgb", "provisional", "crossing", "sigma_um")
"""What a tile has for each point, beside the quality that may be missing."""


@dataclass(frozen=True)
class BoundingBox:
    """An axis-parallel box in mm."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    @property
    def centre(self) -> NDArray[np.float64]:
        """Shape [3], mm."""
        return (np.asarray(self.low) + np.asarray(self.high)) / 2

    @property
    def radius_mm(self) -> float:
        """Half of the box's diagonal."""
        return float(np.linalg.norm(np.asarray(self.high) - np.asarray(self.low)) / 2)

    def joined(self, other: BoundingBox) -> BoundingBox:
        """The smallest box around both."""
        low, high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        return BoundingBox(_triple(low), _triple(high))


@dataclass(frozen=True)
class Tile:
    """The points of one tile of the cloud."""

    origin_mm: tuple[float, float, float]
    xyz: NDArray[np.float32]
    """Shape [n, 3], mm about the origin."""
    rgb: NDArray[np.uint8]
    """Shape [n, 3], as the camera saw it."""
    provisional: NDArray[np.bool_]
    """Shape [n], true while the pixel's maximum has not settled."""
    crossing: NDArray[np.float32]
    """Shape [n], fractional 0-based frame index."""
    sigma_um: NDArray[np.float32]
    """Shape [n], standard deviation along the camera's ray."""
    quality: NDArray[np.uint16] | None = None
    """Shape [n], quality bits; None where they are not known (the live cloud does not carry them)."""

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.xyz)

    def same_as(self, other: Tile | None) -> bool:
        """True if nothing that is shown differs."""
        if other is None or (self.origin_mm, self.count) != (other.origin_mm, other.count):
            return False
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in COLUMNS)

    def differs_little(self, other: Tile | None) -> bool:
        """True if so few points came, went, moved or settled that the difference is hardly seen."""
        if other is None or abs(self.count - other.count) > SMALL_SHARE * other.count:
            return False
        if self.count != other.count:
            return True  # which ones came is not known; but they are few
        shift = (np.asarray(self.origin_mm) - np.asarray(other.origin_mm)).astype(np.float32)
        moved = np.abs(self.xyz - other.xyz + shift).max(axis=1) > SMALL_MOVE * (self.spacing_mm or 0.0)
        return bool((moved | (self.provisional != other.provisional)).mean() <= SMALL_FLIPS)

    def points_mm(self) -> NDArray[np.float64]:
        """Shape [n, 3], mm about zero."""
        return self.xyz.astype(np.float64) + np.asarray(self.origin_mm)

    def where(self, keep: Any) -> Tile:
        """Some of the points: ``keep`` is a mask [n], indices, or a slice."""
        kept = {name: getattr(self, name)[keep] for name in COLUMNS}
        return replace(self, **kept, quality=self.quality[keep] if self.quality is not None else None)

    def thinned(self, keep_one_of: int) -> Tile:
        """Every ``keep_one_of``-th point, spread evenly; what a stronger thinning keeps, a weaker one keeps too."""
        if keep_one_of <= 1:
            return self
        return self.where((np.arange(self.count) * GOLDEN) % 1.0 < 1.0 / keep_one_of)

    def inside(self, box: BoundingBox) -> Tile:
        """The points within ``box``, its faces included."""
        low = (np.asarray(box.low) - self.origin_mm).astype(np.float32)
        high = (np.asarray(box.high) - self.origin_mm).astype(np.float32)
        within = ((self.xyz >= low) & (self.xyz <= high)).all(axis=1)
        return self if within.all() else self.where(within)

    @cached_property
    def bounds(self) -> BoundingBox | None:
        """A box around nearly all points (stray ones left out), None without points."""
        if not self.count:
            return None
        sample = self.xyz[:: max(1, self.count // BOUNDS_SAMPLE)].astype(np.float64) + np.asarray(self.origin_mm)
        low, high = np.quantile(sample, BOUNDS_QUANTILES, axis=0)
        return BoundingBox(_triple(low), _triple(high))

    @cached_property
    def sphere(self) -> tuple[NDArray[np.float64], float]:
        """Centre [3] and radius in mm of a ball that holds all points; there must be some."""
        low, high = self.xyz.min(axis=0).astype(np.float64), self.xyz.max(axis=0).astype(np.float64)
        return (low + high) / 2 + np.asarray(self.origin_mm), float(np.linalg.norm(high - low)) / 2

    @cached_property
    def spacing_mm(self) -> float | None:
        """Typical distance of neighbours: consecutive points are mostly neighbouring pixels; None if too few."""
        if self.count < 16:
            return None
        steps = np.linalg.norm(np.diff(self.xyz[:BOUNDS_SAMPLE].astype(np.float64), axis=0), axis=1)
        return float(np.median(steps))


def _triple(vector: NDArray[np.float64]) -> tuple[float, float, float]:
    return (float(vector[0]), float(vector[1]), float(vector[2]))


NO_POINTS = Tile(
    (0.0, 0.0, 0.0),
    np.zeros((0, 3), np.float32),
    np.zeros((0, 3), np.uint8),
    np.zeros(0, np.bool_),
    np.zeros(0, np.float32),
    np.zeros(0, np.float32),
)


def parse_tiles(message: ResultTiles, payload: bytes | memoryview) -> tuple[dict[int, Tile], int]:
    """Tiles by number from a message and its second part, and how many points were left out as not finite.

    Raises:
        ProtocolError: the payload's length is not that of the points which the header announces.
    """
    announced = sum(header.count for header in message.tiles)
    if len(payload) != announced * POINT.itemsize:
        raise ProtocolError(f"{len(payload)} bytes of points where {announced * POINT.itemsize} were announced")
    points = np.frombuffer(payload, dtype=POINT)
    tiles: dict[int, Tile] = {}
    start = left_out = 0
    for header in message.tiles:
        part = points[start : start + header.count]
        start += header.count
        tile = tile_of_records(header.origin_mm, part)
        finite = np.isfinite(tile.xyz).all(axis=1) & bool(np.isfinite(header.origin_mm).all())
        if not finite.all():
            left_out += int((~finite).sum())
            tile = tile.where(finite)
        tiles[header.tile] = tile if tile.count else replace(tile, origin_mm=(0.0, 0.0, 0.0))
    return tiles, left_out


def tile_of_records(
    origin_mm: tuple[float, float, float], records: NDArray[Any], quality: NDArray[np.uint16] | None = None
) -> Tile:
    """The tile of records with the fields of ``POINT`` (as :data:`acquire.contract.messaging.point_record.POINT`)."""
    return Tile(
        origin_mm,
        np.stack([records["x"], records["y"], records["z"]], axis=1),
        np.stack([records["red"], records["green"], records["blue"]], axis=1),
        records["provisional"] != 0,
        records["crossing"].copy(),
        records["sigma_um"].copy(),
        quality,
    )


def merged(tiles: Sequence[Tile], origin_mm: tuple[float, float, float]) -> Tile:
    """All points of ``tiles`` as one tile about ``origin_mm``; the shift is done in float64."""
    origin = np.asarray(origin_mm)
    xyz = np.concatenate([tile.xyz + (np.asarray(tile.origin_mm) - origin) for tile in tiles]).astype(np.float32)
    rest = {name: np.concatenate([getattr(tile, name) for tile in tiles]) for name in COLUMNS if name != "xyz"}
    qualities = [tile.quality for tile in tiles if tile.quality is not None]
    return Tile(origin_mm, xyz, **rest, quality=np.concatenate(qualities) if len(qualities) == len(tiles) else None)


def power_of_two(total: int, budget: int) -> int:
    """The smallest power of two such that one of so many stays within the budget; it seldom changes."""
    one_of = 1
    while total > budget * one_of:
        one_of *= 2
    return one_of


def bounding_box_of(tiles: Iterable[Tile]) -> BoundingBox | None:
    """The box around all tiles; those with a handful of stray points count only if there are no others."""
    found = [(tile.count, box) for tile in tiles if (box := tile.bounds) is not None]
    if not found:
        return None
    enough = max(count for count, _ in found) // 50
    boxes = [box for count, box in found if count >= enough]
    low = np.min([box.low for box in boxes], axis=0)
    high = np.max([box.high for box in boxes], axis=0)
    return BoundingBox(_triple(low), _triple(high))
