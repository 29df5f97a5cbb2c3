"""The pictures of a scan's page: maps, a cross-section to scale, histograms. Pure: results in, figures out."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import NullFormatter
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar
from numpy.typing import NDArray

from acquire.contract.units import UM_PER_MM, nice_length
from process.crossings.quality import Quality

from .load import ScanResults

WIDE = (10.0, 4.2)
SHOWN_BITS = (
    (Quality.LIT_AT_START, "lit at the start", "#b15928"),
    (Quality.PLATEAU_NOT_REACHED, "plateau not reached", "#6a3d9a"),
    (Quality.FILTERED, "filtered", "#e31a1c"),
    (Quality.SEVERAL, "light came twice", "#ff7f00"),
    (Quality.SATURATED, "saturated", "#ffd92f"),
    (Quality.NO_DARK_LEVEL, "no dark level", "#1f78b4"),
    (Quality.MISSING_NEIGHBOUR, "beside a missing frame", "#b2df8a"),
)
"""In this order: the first bit that a pixel has gives its colour."""
OUTSIDE, UNREMARKABLE = "#f2f2f2", "#9fc5a8"


def contrast_picture(results: ScanResults) -> Figure:
    """Brightest value of each pixel, and which of them pass the contrast mask, with what is remarkable of them."""
    figure, (left, right) = _two()
    left.imshow(results.maps["max"], cmap="gray", interpolation="antialiased")
    left.set_title("brightest value of each pixel")
    quality, mask = results.maps["quality"], results.maps["mask"] != 0
    kind = np.where(mask, 1, 0)
    for place, (bit, _, _) in reversed(list(enumerate(SHOWN_BITS))):
        kind[(quality & int(bit)) != 0] = place + 2
    colours = ListedColormap([OUTSIDE, UNREMARKABLE, *(colour for _, _, colour in SHOWN_BITS)])
    right.imshow(
        kind, cmap=colours, norm=BoundaryNorm(np.arange(colours.N + 1) - 0.5, colours.N), interpolation="nearest"
    )
    names = ["below the contrast", "good", *(name for _, name, _ in SHOWN_BITS)]
    number = np.bincount(kind.ravel(), minlength=colours.N)
    shown = [
        Patch(facecolor=colours(k), edgecolor="#999999", label=f"{names[k]} ({number[k]})")
        for k in range(colours.N)
        if k < 2 or number[k]
    ]
    right.legend(handles=shown, loc="upper left", bbox_to_anchor=(0.0, -0.1), fontsize="small", ncols=2)
    _around(results, left, right)
    right.set_title("contrast mask and quality (pixels)")
    return figure


def crossing_picture(results: ScanResults) -> Figure:
    """When the light passed, and how well that is known."""
    figure, (left, right) = _two()
    crossing = results.maps["crossing"]
    image = left.imshow(crossing, cmap="viridis", interpolation="nearest")
    figure.colorbar(image, ax=left, label="frame", location="bottom", shrink=0.9)
    left.set_title("crossing of half brightness")
    um = np.isfinite(results.sigma_um).any()
    sigma = results.sigma_um if um else results.maps["sigma"]
    known = sigma[np.isfinite(sigma) & (sigma > 0)]
    low, high = np.percentile(known, (1, 99)) if known.size else (0.0, 1.0)
    image = right.imshow(
        np.where(sigma > 0, sigma, np.nan), cmap="magma", vmin=low, vmax=max(high, low + 1e-6), interpolation="nearest"
    )
    unit = "um" if um else "frames"
    figure.colorbar(image, ax=right, label=unit, location="bottom", shrink=0.9, extend="both")
    _around(results, left, right)
    right.set_title("standard deviation of a point along its ray" if um else "standard deviation of the crossing")
    return figure


def section_picture(results: ScanResults) -> Figure | None:
    """The points of one row of the image from the side, to scale; None without a cloud."""
    if results.cloud is None or not results.in_cloud.any():
        return None
    row = _fullest_row(results)
    order = np.cumsum(results.in_cloud.ravel()).reshape(results.in_cloud.shape) - 1
    points = results.cloud[order[row][results.in_cloud[row]]]
    along, height, sigma = _from_the_side(points)
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    axes: Any = figure.subplots()
    axes.errorbar(along, height, yerr=3 * sigma, fmt="none", ecolor="#dcdcdc", elinewidth=0.7, zorder=1)
    colour = np.stack([points[c] for c in ("red", "green", "blue")], axis=1) / 255.0
    axes.scatter(along, height, s=5, c=colour * 0.85, zorder=2, linewidths=0)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="along the row, mm", ylabel="z, mm")
    axes.set_title(f"cross-section along image row {row}: {len(points)} points, to scale, bars: 3 standard deviations")
    _scale_bar(axes, float(np.ptp(along)))
    axes.grid(alpha=0.3)
    return figure


def histogram_picture(results: ScanResults) -> Figure:
    """Contrast of all pixels against the threshold, and the standard deviations of the points."""
    figure, (left, right) = _two()
    counts = np.array(results.report.contrast_histogram)
    left.bar(np.arange(len(counts)), counts, width=1.0, color="#5b7f95")
    left.set_yscale("symlog", linthresh=10)
    threshold = int(results.report.settings["contrast"])
    left.axvline(threshold, color="#b00020")
    left.annotate(
        f" threshold {threshold}", (threshold, 1.0), xycoords=("data", "axes fraction"), va="top", color="#b00020"
    )
    left.set(xlabel="brightest - darkest, counts of 8 bit", ylabel="pixels", title="contrast")
    um = results.cloud is not None and len(results.cloud) > 0
    sigma = results.cloud["sigma_um"] if um and results.cloud is not None else results.maps["sigma"].ravel()
    sigma = sigma[np.isfinite(sigma) & (sigma > 0)]
    if sigma.size:
        low, high = np.percentile(sigma, (0.1, 99.9))
        wide = high > 20 * low
        spaced = np.geomspace if wide else np.linspace
        bins = spaced(0.95 * float(low), 1.05 * float(high), 60)
        right.hist(sigma, bins=bins, color="#5b7f95")
        if wide:
            right.set_xscale("log")
            ticks = _plain_ticks(float(bins[0]), float(bins[-1]))
            right.set_xticks(ticks, labels=[f"{tick:g}" for tick in ticks])
            right.xaxis.set_minor_formatter(NullFormatter())
        right.axvline(np.median(sigma), color="#222222", linestyle="--")
        unit = "um" if um else "frames"
        right.set(
            xlabel=f"standard deviation, {unit}",
            title=f"points by uncertainty, median {two_digits(np.median(sigma))} {unit}",
        )
    return figure


def _around(results: ScanResults, *pictures: Any) -> None:
    """Show the pixels over the contrast and a little around them."""
    rows, columns = np.nonzero(results.maps["mask"])
    if not rows.size:
        return
    height, width = results.maps["mask"].shape
    margin = 10 + max(height, width) // 50
    for axes in pictures:
        axes.set_xlim(max(columns.min() - margin, 0) - 0.5, min(columns.max() + margin, width - 1) + 0.5)
        axes.set_ylim(min(rows.max() + margin, height - 1) + 0.5, max(rows.min() - margin, 0) - 0.5)


def two_digits(value: Any) -> str:
    """A number to two digits, without an exponent where it has a usual size."""
    return f"{float(f'{value:.2g}'):g}"


def _two() -> tuple[Figure, Any]:
    figure = Figure(figsize=WIDE, layout="constrained")
    return figure, figure.subplots(1, 2)


def _plain_ticks(low: float, high: float) -> NDArray[np.float64]:
    """1, 2, 5 x powers of ten within the bounds."""
    decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    ticks: NDArray[np.float64] = (decades[:, None] * np.array([1.0, 2.0, 5.0])).ravel()
    return ticks[(ticks >= low) & (ticks <= high)]


def _fullest_row(results: ScanResults) -> int:
    """The row with the most points, of equals the one nearest to the middle."""
    count = results.in_cloud.sum(axis=1)
    rows = np.flatnonzero(count == count.max())
    return int(rows[np.argmin(np.abs(rows - len(count) / 2))])


def _from_the_side(points: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Distance along the row on the floor, height, and standard deviation, all in mm."""
    floor = np.stack([points["x"], points["y"]], axis=1).astype(np.float64)
    middle = floor.mean(axis=0)
    direction = np.linalg.svd(floor - middle, full_matrices=False)[2][0]
    direction = direction * (1.0 if direction[np.argmax(np.abs(direction))] > 0 else -1.0)
    return (floor - middle) @ direction, points["z"].astype(np.float64), points["sigma_um"] / UM_PER_MM


def _scale_bar(axes: Any, extent_mm: float) -> None:
    """A bar of a round length, at most a quarter of the picture."""
    most = max(extent_mm / 4, 1e-6)
    length = nice_length(most)
    text = f"{length:g} mm" if length >= 0.1 else f"{length * UM_PER_MM:g} um"
    axes.add_artist(AnchoredSizeBar(axes.transData, length, text, "lower right", pad=0.5, size_vertical=length / 40))
