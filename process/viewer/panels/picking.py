"""Which point of the cloud a click means, what is known of it, distances with their uncertainty, sections. Pure."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.contract.units import UM_PER_MM
from process.crossings.quality import Quality
from process.viewer.rig_client.tile import BoundingBox, Tile

NEAR_PX = 7.0
"""A click means a point within so many screen pixels."""
DEPTH = 6.0
"""Of the points that the ray passes, those behind the first by more than so many tolerances are hidden."""
QUALITY_WORDS = {
    Quality.LIT_AT_START: "lit at the start",
    Quality.PLATEAU_NOT_REACHED: "plateau not reached",
    Quality.NO_DARK_LEVEL: "no dark level",
    Quality.SATURATED: "saturated",
    Quality.SEVERAL: "several crossings",
    Quality.FROM_FILE: "resolved from the file",
    Quality.MISSING_NEIGHBOUR: "next to a missing frame",
    Quality.FILTERED: "filtered",
    Quality.OTHER_LIGHT: "in another light",
}


@dataclass(frozen=True)
class Ray:
    """A click: the line of sight through the clicked pixel."""

    origin_mm: tuple[float, float, float]
    direction: tuple[float, float, float]
    radians_per_px: float


@dataclass(frozen=True)
class PickedPoint:
    """A point of the cloud."""

    xyz_mm: tuple[float, float, float]
    sigma_um: float
    """Standard deviation along the camera's ray."""
    crossing: float
    quality: int | None
    """Quality bits; None where they are not known."""
    provisional: bool
    along: tuple[float, float, float] | None
    """Unit vector of the camera's ray, along which the point is uncertain; None: not known, then any direction."""

    def sigma_along_um(self, direction: NDArray[np.float64]) -> float:
        """Its standard deviation along a unit vector."""
        return self.sigma_um * (abs(float(np.dot(self.along, direction))) if self.along is not None else 1.0)


@dataclass(frozen=True)
class Length:
    """A length with its standard deviation, um."""

    um: float
    sigma_um: float

    def __str__(self) -> str:
        return f"{self.um:,.1f} ± {max(self.sigma_um, 0.05):.1f} µm"


@dataclass(frozen=True)
class Distance:
    """From one picked point to another."""

    first: PickedPoint
    second: PickedPoint

    @property
    def _delta_mm(self) -> NDArray[np.float64]:
        return np.asarray(self.second.xyz_mm) - np.asarray(self.first.xyz_mm)

    def _length(self, um: float, direction: NDArray[np.float64]) -> Length:
        size = float(np.linalg.norm(direction))
        unit = direction / size if size > 0 else np.array([0.0, 0.0, 1.0])
        return Length(um, math.hypot(self.first.sigma_along_um(unit), self.second.sigma_along_um(unit)))

    @property
    def straight(self) -> Length:
        """In space."""
        return self._length(float(np.linalg.norm(self._delta_mm)) * UM_PER_MM, self._delta_mm)

    @property
    def horizontal(self) -> Length:
        """Within z = 0."""
        flat = self._delta_mm * (1.0, 1.0, 0.0)
        return self._length(float(np.linalg.norm(flat)) * UM_PER_MM, flat)

    @property
    def height(self) -> Length:
        """Upward from the first to the second; negative is down."""
        return self._length(float(self._delta_mm[2]) * UM_PER_MM, np.array([0.0, 0.0, 1.0]))


@dataclass(frozen=True)
class Profile:
    """A section along the line between two points, seen from the side."""

    along_mm: NDArray[np.float64]
    """Shape [n], horizontal distance from the first point."""
    mean_mm: NDArray[np.float64]
    """Shape [n], mean height in each bin; NaN where there are no points."""
    low_mm: NDArray[np.float64]
    high_mm: NDArray[np.float64]
    width_mm: float
    """Points within half of this on either side count."""
    points: int


def pick(
    tiles: Iterable[Tile], ray: Ray, least_mm: float, eye_mm: NDArray[np.float64] | None, box: BoundingBox | None = None
) -> PickedPoint | None:
    """The frontmost point within a few screen pixels of the ray (or ``least_mm``); None where there is none.

    Args:
        tiles: where to look.
        ray: in mm.
        least_mm: half of the size of a drawn point.
        eye_mm: the rig's camera, for the direction of the uncertainty; None if it is not known.
        box: points outside are not seen, and not picked.
    """
    direction = np.asarray(ray.direction) / float(np.linalg.norm(ray.direction))
    spread = NEAR_PX * ray.radians_per_px
    found = [
        hit
        for tile in tiles
        if _near(tile, ray, direction, least_mm, spread)
        and (hit := _hits(tile if box is None else tile.inside(box), ray, direction, least_mm, spread)) is not None
    ]
    if not found:
        return None
    # the point nearest to the ray would often be one of the far side, seen between two drawn points of the near side
    front = min(float(along.min()) for _, along, _ in found)
    tolerance = max(least_mm, spread * front)
    best: tuple[float, Tile, int] | None = None
    for tile, along, off in found:
        score = np.where(along <= front + DEPTH * tolerance, off, np.inf)
        index = int(score.argmin())
        if best is None or score[index] < best[0]:
            best = (float(score[index]), tile, index)
    return _picked(best[1], best[2], eye_mm) if best is not None else None


def _near(tile: Tile, ray: Ray, direction: NDArray[np.float64], least_mm: float, spread: float) -> bool:
    if not tile.count:
        return False
    centre, radius = tile.sphere
    about = centre - np.asarray(ray.origin_mm)
    along = float(about @ direction)
    off = float(np.linalg.norm(about - along * direction))
    return along > -radius and off <= radius + max(least_mm, spread * (along + radius))


def _hits(
    tile: Tile, ray: Ray, direction: NDArray[np.float64], least_mm: float, spread: float
) -> tuple[Tile, NDArray[np.float64], NDArray[np.float64]] | None:
    about = tile.xyz.astype(np.float64) - (np.asarray(ray.origin_mm) - np.asarray(tile.origin_mm))
    along = about @ direction
    off = np.sqrt(np.maximum((about**2).sum(axis=1) - along**2, 0.0))
    near = np.flatnonzero((along > 0) & (off <= np.maximum(least_mm, spread * along)))
    return (tile.where(near), along[near], off[near]) if near.size else None


def _picked(tile: Tile, index: int, eye_mm: NDArray[np.float64] | None) -> PickedPoint:
    point = tile.xyz[index].astype(np.float64) + np.asarray(tile.origin_mm)
    along = None
    if eye_mm is not None:
        ray = point - eye_mm
        unit = ray / float(np.linalg.norm(ray))
        along = (float(unit[0]), float(unit[1]), float(unit[2]))
    return PickedPoint(
        xyz_mm=(float(point[0]), float(point[1]), float(point[2])),
        sigma_um=float(tile.sigma_um[index]),
        crossing=float(tile.crossing[index]),
        quality=int(tile.quality[index]) if tile.quality is not None else None,
        provisional=bool(tile.provisional[index]),
        along=along,
    )


def quality_words(quality: int | None) -> str:
    """The quality bits in words."""
    if quality is None:
        return "not known while it is live"
    return ", ".join(words for bit, words in QUALITY_WORDS.items() if quality & bit) or "good"


def profile(tiles: Iterable[Tile], distance: Distance, width_mm: float, bins: int = 200) -> Profile | None:
    """Heights along the line between two points; None if they stand over each other."""
    start, end = np.asarray(distance.first.xyz_mm[:2]), np.asarray(distance.second.xyz_mm[:2])
    length = float(np.linalg.norm(end - start))
    if length <= 0:
        return None
    unit = (end - start) / length
    along, height = [], []
    for tile in tiles:
        about = tile.points_mm() - np.array([*start, 0.0])
        position = about[:, :2] @ unit
        aside = np.abs(about[:, 0] * unit[1] - about[:, 1] * unit[0])
        within = (position >= 0) & (position <= length) & (aside <= width_mm / 2)
        along.append(position[within])
        height.append(about[within, 2])
    positions = np.concatenate(along) if along else np.zeros(0)
    heights = np.concatenate(height) if height else np.zeros(0)
    return _binned(positions, heights, length, width_mm, bins)


def _binned(
    positions: NDArray[np.float64], heights: NDArray[np.float64], length: float, width_mm: float, bins: int
) -> Profile:
    which = np.minimum((positions / length * bins).astype(np.intp), bins - 1)
    counts = np.bincount(which, minlength=bins)
    low, high = np.full(bins, np.inf), np.full(bins, -np.inf)
    np.minimum.at(low, which, heights)
    np.maximum.at(high, which, heights)
    empty = counts == 0
    with np.errstate(invalid="ignore"):
        mean = np.where(empty, np.nan, np.bincount(which, heights, bins) / np.maximum(counts, 1))
    low[empty] = high[empty] = np.nan
    return Profile((np.arange(bins) + 0.5) / bins * length, mean, low, high, width_mm, len(positions))


def measurements_csv(scan: str, distances: Sequence[tuple[str, Distance]]) -> str:
    """One line for each measurement, with a header that names units."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    lengths = ("straight", "horizontal", "height")
    table.writerow(
        ["scan", "name"]
        + [f"{axis}{which}_mm" for which in (1, 2) for axis in "xyz"]
        + [f"sigma{which}_um" for which in (1, 2)]
        + [f"{name}{part}_um" for name in lengths for part in ("", "_sigma")]
        + ["quality1", "quality2"]
    )
    for name, distance in distances:
        ends = (distance.first, distance.second)
        found = [getattr(distance, length) for length in lengths]
        table.writerow(
            [scan, name]
            + [f"{value:.6f}" for end in ends for value in end.xyz_mm]
            + [f"{end.sigma_um:.3f}" for end in ends]
            + [f"{value:.3f}" for length in found for value in (length.um, length.sigma_um)]
            + [quality_words(end.quality) for end in ends]
        )
    return text.getvalue()
