"""How points are coloured: the quantity that is shown, its range, the plane it is measured from, the legend. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from acquire.contract.colormaps import QUANTITY_MAP, MapName, coloured
from acquire.contract.units import UM_PER_MM, nice_length
from process.viewer.rig_client.tile import BoundingBox, Tile

ColourMode = Literal["photograph", "height", "crossing", "sigma", "deviation"]
MODES: Final[tuple[ColourMode, ...]] = get_args(ColourMode)

PROVISIONAL_RGB = (255, 150, 40)
"""Points whose maximum has not settled are mixed toward this colour; the legend shows it."""
PROVISIONAL_MIX = 0.65
PROVISIONAL_DIM = 0.45
"""Where the colour tells a value, provisional points keep it, darker."""
SAMPLE = 60_000
"""Points that decide on a range; as good as all of them."""
QUANTILES = (0.01, 0.99)
BINS = 32
TRIMMING = 2.5
"""Points further from the fitted plane than so many standard deviations do not count for it."""
TRIMS = 4
FEWEST = 16


@dataclass(frozen=True)
class ColourQuantity:
    """What one colour mode shows."""

    title: str
    unit: str
    decimals: int


QUANTITIES: Final[dict[ColourMode, ColourQuantity]] = {
    "height": ColourQuantity("Height over z = 0", "mm", 3),
    "crossing": ColourQuantity("Crossing time", "frame", 1),
    "sigma": ColourQuantity("Standard deviation", "µm", 2),
    "deviation": ColourQuantity("Deviation from the fitted plane", "µm", 1),
}


@dataclass(frozen=True)
class ViewSettings:
    """What people chose; the same for all browsers."""

    mode: ColourMode = "photograph"
    low: float | None = None
    """Typed lower end of the range, in the unit of the quantity; None: the 1 % quantile."""
    high: float | None = None
    size_factor: float = 1.0
    max_points: int = 2_000_000
    box: BoundingBox | None = None
    """Only points within are sent; None sends all."""


@dataclass(frozen=True)
class FittedPlane:
    """z = slope_x (x - x0) + slope_y (y - y0) + z0, robustly fitted; what is left is measured along its normal."""

    centre_mm: tuple[float, float, float]
    slope_x: float
    slope_y: float
    rms_um: float
    """Of the points that counted."""

    @property
    def normal(self) -> NDArray[np.float64]:
        """Unit normal, upward."""
        normal = np.array([-self.slope_x, -self.slope_y, 1.0])
        return normal / float(np.linalg.norm(normal))

    @property
    def tilt_degrees(self) -> float:
        """Angle between the plane and z = 0."""
        return math.degrees(math.acos(min(1.0, float(self.normal[2]))))

    def deviation_um(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signed distances of points [n, 3] from the plane, positive above it."""
        found: NDArray[np.float64] = (points_mm - np.asarray(self.centre_mm)) @ self.normal * UM_PER_MM
        return found


@dataclass(frozen=True)
class ValueRange:
    """The values between which colours change."""

    low: float
    high: float


@dataclass(frozen=True)
class Legend:
    """What stands beside the colours."""

    title: str
    unit: str
    map_name: MapName
    low: float
    high: float
    decimals: int
    below_percent: float
    """Share of the points under the range."""
    above_percent: float
    bins: tuple[float, ...]
    """Histogram within the range, the highest bin is 1."""
    note: str = ""
    """What was done to the values (the form that was removed)."""


def sample(tiles: Iterable[Tile], most: int = SAMPLE) -> list[Tile]:
    """About ``most`` points spread evenly over all tiles."""
    found = [tile for tile in tiles if tile.count]
    one_of = max(1, math.ceil(sum(tile.count for tile in found) / most))
    return [tile.where(slice(None, None, one_of)) for tile in found]


def values_of(tile: Tile, mode: ColourMode, plane: FittedPlane | None) -> NDArray[np.float32]:
    """The quantity of ``mode`` for each point, shape [n]; NaN where there is none."""
    if mode == "height":
        return (tile.xyz[:, 2].astype(np.float64) + tile.origin_mm[2]).astype(np.float32)
    if mode == "crossing":
        return tile.crossing
    if mode == "sigma":
        return tile.sigma_um
    if mode == "deviation" and plane is not None:
        return plane.deviation_um(tile.points_mm()).astype(np.float32)
    return np.full(tile.count, np.nan, np.float32)


def colours_of(tile: Tile, mode: ColourMode, within: ValueRange | None, plane: FittedPlane | None) -> NDArray[np.uint8]:
    """Shape [n, 3] RGB: as photographed, or the quantity in its map; provisional points are marked."""
    if mode == "photograph" or within is None:
        base, toward, mix = tile.rgb.astype(np.float32), np.asarray(PROVISIONAL_RGB, np.float32), PROVISIONAL_MIX
    else:
        values = values_of(tile, mode, plane)
        base = coloured(values, within.low, within.high, QUANTITY_MAP[mode]).astype(np.float32)
        toward, mix = np.zeros(3, np.float32), 1 - PROVISIONAL_DIM
    mixed = np.where(tile.provisional[:, None], (1 - mix) * base + mix * toward, base)
    return mixed.astype(np.uint8)


def fit_plane(tiles: Iterable[Tile]) -> FittedPlane | None:
    """The plane through most points, those that stand out left aside; None with too few points."""
    parts = [tile.points_mm() for tile in sample(tiles)]
    points = np.concatenate(parts) if parts else np.zeros((0, 3))
    kept = np.ones(len(points), np.bool_)
    found = None
    for _ in range(TRIMS):
        if kept.sum() < FEWEST:
            return found
        centre = points[kept].mean(axis=0)
        about = points - centre
        design = about[:, :2]
        slopes, *_ = np.linalg.lstsq(design[kept], about[kept, 2], rcond=None)
        # distances along the normal, not along z
        residual = (about[:, 2] - design @ slopes) / math.hypot(1.0, *slopes)
        # 1.4826 median absolute deviations are the standard deviation of normal noise, whatever stands on the plane
        spread = 1.4826 * float(np.median(np.abs(residual[kept]))) + 1e-9
        rms_um = float(np.sqrt(np.mean(residual[kept] ** 2))) * UM_PER_MM
        found = FittedPlane((centre[0], centre[1], centre[2]), float(slopes[0]), float(slopes[1]), rms_um)
        kept = np.abs(residual) <= TRIMMING * spread
    return found


def automatic_range(values: NDArray[np.float32], mode: ColourMode) -> ValueRange:
    """The 1 % and 99 % quantiles, rounded outward so that a growing cloud is seldom recoloured."""
    known = values[np.isfinite(values)]
    if not known.size:
        return ValueRange(0.0, 1.0)
    low, high = (float(edge) for edge in np.quantile(known.astype(np.float64), QUANTILES))
    if mode == "deviation":
        low, high = -max(-low, high, 0.0), max(-low, high, 0.0)
    step = nice_length((high - low) / 10) if high > low else max(abs(high), 1.0) * 0.01
    return ValueRange(math.floor(low / step + 1e-9) * step, math.ceil(high / step - 1e-9) * step)


def chosen_range(settings: ViewSettings, values: NDArray[np.float32]) -> ValueRange:
    """Typed ends where there are any, the automatic ones elsewhere."""
    auto = automatic_range(values, settings.mode)
    low = auto.low if settings.low is None else settings.low
    high = auto.high if settings.high is None else settings.high
    return ValueRange(low, high) if high > low else ValueRange(low, low + max(abs(low), 1.0) * 1e-6)


def legend_of(mode: ColourMode, within: ValueRange, values: NDArray[np.float32], plane: FittedPlane | None) -> Legend:
    """The legend of a quantity over a sample of its values."""
    quantity = QUANTITIES[mode]
    known = values[np.isfinite(values)]
    total = max(1, known.size)
    counts, _ = np.histogram(known, bins=BINS, range=(within.low, within.high))
    note = ""
    if mode == "deviation":
        note = "no plane yet" if plane is None else _form_words(plane)
    return Legend(
        title=quantity.title,
        unit=quantity.unit,
        map_name=QUANTITY_MAP[mode],
        low=within.low,
        high=within.high,
        decimals=quantity.decimals,
        below_percent=100.0 * float((known < within.low).sum()) / total,
        above_percent=100.0 * float((known > within.high).sum()) / total,
        bins=tuple(float(count) for count in counts / max(1, counts.max())),
        note=note,
    )


def _form_words(plane: FittedPlane) -> str:
    return f"removed: a plane tilted by {plane.tilt_degrees:.2f}°, RMS {plane.rms_um:.1f} µm about it"
