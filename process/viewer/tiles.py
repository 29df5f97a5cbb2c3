"""Pure: the points of result tiles as arrays ready to draw; checks them, colours provisional ones, thins evenly."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ProtocolError
from acquire.contract.messages import ResultTiles
from acquire.contract.points import POINT

PROVISIONAL_RGB = (255, 150, 40)
"""Points whose maximum has not settled are mixed toward this colour; the legend shows it."""
PROVISIONAL_MIX = 0.65
GOLDEN = 0.6180339887498949
"""Fractional part of the golden ratio: multiples of it fill [0, 1) evenly and never fall in step with image rows."""
BOUNDS_SAMPLE = 512
BOUNDS_QUANTILES = (0.02, 0.98)
"""A few stray points must not move the camera away from the object."""


@dataclass(frozen=True)
class Bounds:
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

    def joined(self, other: Bounds) -> Bounds:
        """The smallest box around both."""
        low, high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        return Bounds(_triple(low), _triple(high))


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

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.xyz)

    def shown_rgb(self) -> NDArray[np.uint8]:
        """Shape [n, 3]: camera colour, mixed toward :data:`PROVISIONAL_RGB` where provisional."""
        colours = self.rgb.astype(np.float32)
        mixed = (1 - PROVISIONAL_MIX) * colours + PROVISIONAL_MIX * np.asarray(PROVISIONAL_RGB, np.float32)
        return np.where(self.provisional[:, None], mixed, colours).astype(np.uint8)

    def thinned(self, keep_one_of: int) -> Tile:
        """Every ``keep_one_of``-th point, spread evenly; what a stronger thinning keeps, a weaker one keeps too."""
        if keep_one_of <= 1:
            return self
        keep = (np.arange(self.count) * GOLDEN) % 1.0 < 1.0 / keep_one_of
        return Tile(self.origin_mm, self.xyz[keep], self.rgb[keep], self.provisional[keep])

    @cached_property
    def bounds(self) -> Bounds | None:
        """A box around nearly all points (stray ones left out), None without points."""
        if not self.count:
            return None
        sample = self.xyz[:: max(1, self.count // BOUNDS_SAMPLE)].astype(np.float64) + np.asarray(self.origin_mm)
        low, high = np.quantile(sample, BOUNDS_QUANTILES, axis=0)
        return Bounds(_triple(low), _triple(high))

    @cached_property
    def spacing_mm(self) -> float | None:
        """Typical distance of neighbours: consecutive points are mostly neighbouring pixels; None if too few."""
        if self.count < 16:
            return None
        steps = np.linalg.norm(np.diff(self.xyz[:BOUNDS_SAMPLE].astype(np.float64), axis=0), axis=1)
        return float(np.median(steps))


def _triple(vector: NDArray[np.float64]) -> tuple[float, float, float]:
    return (float(vector[0]), float(vector[1]), float(vector[2]))


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
        xyz = np.stack([part["x"], part["y"], part["z"]], axis=1)
        rgb = np.stack([part["red"], part["green"], part["blue"]], axis=1)
        provisional = part["provisional"] != 0
        finite = np.isfinite(xyz).all(axis=1)
        if not np.isfinite(header.origin_mm).all():
            finite[:] = False
        if not finite.all():
            left_out += int((~finite).sum())
            xyz, rgb, provisional = xyz[finite], rgb[finite], provisional[finite]
        origin = header.origin_mm if xyz.size else (0.0, 0.0, 0.0)
        tiles[header.tile] = Tile(origin, xyz, rgb, provisional)
    return tiles, left_out


def merged(tiles: Sequence[Tile], origin_mm: tuple[float, float, float]) -> Tile:
    """All points of ``tiles`` as one tile about ``origin_mm``; the shift is done in float64."""
    origin = np.asarray(origin_mm)
    shifted = [tile.xyz + (np.asarray(tile.origin_mm) - origin) for tile in tiles]
    return Tile(
        origin_mm,
        np.concatenate(shifted).astype(np.float32),
        np.concatenate([tile.rgb for tile in tiles]),
        np.concatenate([tile.provisional for tile in tiles]),
    )


def power_of_two(total: int, budget: int) -> int:
    """The smallest power of two such that one of so many stays within the budget; it seldom changes."""
    one_of = 1
    while total > budget * one_of:
        one_of *= 2
    return one_of


def bounds_of(tiles: Iterable[Tile]) -> Bounds | None:
    """The box around all tiles; those with a handful of stray points count only if there are no others."""
    found = [(tile.count, box) for tile in tiles if (box := tile.bounds) is not None]
    if not found:
        return None
    enough = max(count for count, _ in found) // 50
    boxes = [box for count, box in found if count >= enough]
    low = np.min([box.low for box in boxes], axis=0)
    high = np.max([box.high for box in boxes], axis=0)
    return Bounds(_triple(low), _triple(high))
