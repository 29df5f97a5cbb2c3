"""A figure for a paper: the cloud from above, to scale, with scale bar, legend and what was shown, as PNG.

Imported only when a figure is asked for: matplotlib takes half a second.
"""

from __future__ import annotations

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from acquire.contract.colormaps import table
from acquire.contract.units import nice_length
from process.viewer.rig_client.tile import BoundingBox, Tile
from process.viewer.scene.camera_views import DEFAULT_BOUNDS
from process.viewer.stream.colouring import Legend

from .shown_cloud import ShownCloud

FIGURE_PIXELS = 900
FIGURE_POINTS = 2_000_000
WIDTH_INCHES = 6.4
DPI = 200


def figure_png(shown: ShownCloud) -> bytes:
    """The cloud from above, to scale, with a scale bar, the legend and what was shown, as PNG."""
    tile = shown.thinned(FIGURE_POINTS)
    bounds = tile.bounds or DEFAULT_BOUNDS
    image, extent = _from_above(tile, shown, bounds)
    tall = WIDTH_INCHES * (extent[3] - extent[2]) / (extent[1] - extent[0])
    figure = Figure(figsize=(WIDTH_INCHES, min(9.0, 1.6 + 0.8 * tall)), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(image, extent=extent, origin="lower", interpolation="nearest")
    axes.set(xlabel="x (mm)", ylabel="y (mm)")
    axes.set_title(shown.title, fontsize=10)
    _scale_bar(axes, extent)
    if shown.legend is not None:
        _colour_bar(figure, axes, shown.legend)
    notes = "; ".join(f"{name} {value}" for name, value in shown.facts)
    figure.supxlabel(notes, fontsize=6, wrap=True)
    target = io.BytesIO()
    figure.savefig(target, format="png", dpi=DPI, metadata={"Software": None})
    return target.getvalue()


Extent = tuple[float, float, float, float]


def _from_above(tile: Tile, shown: ShownCloud, bounds: BoundingBox) -> tuple[NDArray[np.uint8], Extent]:
    """[rows, columns, 4] RGBA, the highest point of each cell, and where it lies in mm."""
    low, high = np.asarray(bounds.low[:2]), np.asarray(bounds.high[:2])
    margin = 0.06 * float((high - low).max())
    low, high = low - margin, high + margin
    spacing = tile.spacing_mm or margin
    cell = max(float((high - low).max()) / FIGURE_PIXELS, 1.1 * spacing)
    shape = np.maximum(np.ceil((high - low) / cell).astype(int), 1)
    points = tile.points_mm()
    at = np.floor((points[:, :2] - low) / cell).astype(int)
    inside = ((at >= 0) & (at < shape)).all(axis=1)
    order = np.flatnonzero(inside)[np.argsort(points[inside, 2], kind="stable")]
    image = np.zeros((shape[1], shape[0], 4), np.uint8)
    image[at[order, 1], at[order, 0], :3] = shown.colours(tile)[order]
    image[at[order, 1], at[order, 0], 3] = 255
    end = low + shape * cell
    return image, (float(low[0]), float(end[0]), float(low[1]), float(end[1]))


def _scale_bar(axes: Axes, extent: Extent) -> None:
    width, height = extent[1] - extent[0], extent[3] - extent[2]
    length = nice_length(width / 4)
    left, bottom = extent[0] + 0.04 * width, extent[2] + 0.04 * height
    axes.add_patch(Rectangle((left, bottom), length, 0.012 * height, color="black"))
    words = f"{length:g} mm" if length >= 0.1 else f"{1000 * length:g} µm"
    axes.text(left + length / 2, bottom + 0.02 * height, words, ha="center", fontsize=8)


def _colour_bar(figure: Figure, axes: Axes, legend: Legend) -> None:
    shades = ListedColormap(table(legend.map_name) / 255.0)
    scale = ScalarMappable(Normalize(legend.low, legend.high), shades)
    bar = figure.colorbar(scale, ax=axes, shrink=0.75, extend="both")
    bar.set_label(f"{legend.title} ({legend.unit})", fontsize=8)
    if legend.note:
        bar.ax.set_title(legend.note, fontsize=5)
