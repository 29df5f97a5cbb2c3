"""The points that there are to show: tiles grouped into a fixed set of nodes, coloured, clipped and thinned.

Nothing is sent from here: the stream of each browser compares what it has sent with the numbers kept here, and asks
for the nodes that its browser lacks. What is prepared for one browser is kept a while for the others.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.contract.units import NS_PER_S
from process.viewer.rig_client.feed import TileChanges
from process.viewer.rig_client.tile import BoundingBox, Tile, bounding_box_of, merged, power_of_two

from .colouring import (
    FittedPlane,
    Legend,
    ValueRange,
    ViewSettings,
    chosen_range,
    colours_of,
    fit_plane,
    legend_of,
    sample,
    values_of,
)

MAX_NODES = 256
"""Thousands of nodes choke the page: with more tiles than this, neighbours share a node."""
OVERVIEW_POINTS = 100_000
"""What a browser gets first: 1.5 MB, a first picture within two seconds at 1 MB/s."""
POINT_BYTES = 15
"""Three float32 and three colour bytes."""
COLOUR_BYTES = 3
POINT_FILL = 1.25
"""Diameter of a drawn point in units of the distance of neighbours: no gaps, no clutter."""
RESIZE = 1.25
"""Points are drawn in another size only if it differs by this factor."""
NEAR_MM = 100.0
"""Within this distance of the origin float32 steps are below 0.01 um."""
DEFAULT_POINT_MM = 0.02
RANGE_NS = 2 * NS_PER_S
"""Least time between two changes of an automatic range: each recolours everything."""
SMALL_NS = 4 * NS_PER_S
"""So long an invisible change may wait: behind the light a few points of each tile still move a little."""
CACHE_BYTES = 48_000_000
"""Prepared nodes kept for other browsers."""


@dataclass(frozen=True)
class NodeData:
    """One node, ready to be sent."""

    points: NDArray[np.float32]
    """Shape [n, 3], mm about the cloud's origin."""
    colours: NDArray[np.uint8]
    """Shape [n, 3] RGB."""


class PointNodes:
    """Mirrors the worker's tiles (or those of an older scan). One thread calls everything."""

    def __init__(self, settings: ViewSettings | None = None) -> None:
        self._settings = settings or ViewSettings()
        self._tiles: dict[int, Tile] = {}
        self._geometry = 0
        self._now_ns = 0
        self._small: dict[int, int] = {}
        self._range_ns = -RANGE_NS
        self._values: NDArray[np.float32] | None = None
        self._cache: OrderedDict[tuple[int, int], tuple[int, int, Tile, NodeData]] = OrderedDict()
        self._cached_bytes = 0
        self.tiles_per_node = 1
        self.marks: dict[int, int] = {}
        """The nodes that there are, each with the number of its last change."""
        self.counts: dict[int, int] = {}
        """Points of each node before thinning and clipping."""
        self.paint = 0
        """Changes whenever all colours do."""
        self.origin_mm: tuple[float, float, float] | None = None
        self.range: ValueRange | None = None
        self.plane: FittedPlane | None = None
        self._point_mm = DEFAULT_POINT_MM

    # ---- what is known ----

    @property
    def settings(self) -> ViewSettings:
        """How it is shown."""
        return self._settings

    @property
    def tiles(self) -> Mapping[int, Tile]:
        """All tiles by number."""
        return self._tiles

    @property
    def points(self) -> int:
        """Number of points of all tiles, shown or not."""
        return sum(self.counts.values())

    @property
    def fine(self) -> int:
        """1: all points are shown in the end; n: one of n, spread evenly."""
        return power_of_two(self.points, self._settings.max_points)

    @property
    def coarse(self) -> int:
        """One of so many points makes the overview that comes first."""
        return max(self.fine, power_of_two(self.points, OVERVIEW_POINTS))

    def bounds(self) -> BoundingBox | None:
        """A box around nearly all points, None without any."""
        return bounding_box_of(self._tiles.values())

    def size_mm(self, one_of: int) -> float:
        """Diameter of a drawn point when one of so many is shown."""
        return round(self._point_mm * self._settings.size_factor * one_of**0.5, 7)

    def legend(self) -> Legend | None:
        """The legend of the shown quantity; None for a photograph."""
        if self._settings.mode == "photograph" or self.range is None or self._values is None:
            return None
        return legend_of(self._settings.mode, self.range, self._values, self.plane)

    # ---- what changes ----

    def take(self, changes: TileChanges) -> None:
        """Note tiles that changed; a snapshot that only repeats what is known changes nothing."""
        if not changes.reset and not changes.tiles:
            return
        gone = set(self._tiles) - set(changes.tiles) if changes.reset else set()
        for number in gone:
            del self._tiles[number]
        changed = {number for number, tile in changes.tiles.items() if not tile.same_as(self._tiles.get(number))}
        small = set() if changes.reset else {n for n in changed if changes.tiles[n].differs_little(self._tiles.get(n))}
        self._tiles.update({number: changes.tiles[number] for number in changed})
        for number in small:
            self._small.setdefault(number // self.tiles_per_node, self._now_ns)
        changed -= small
        if not gone and not changed:
            return
        self._choose_origin()
        needed = power_of_two(max(self._tiles, default=0) + 1, MAX_NODES)
        if needed > self.tiles_per_node:
            self._regroup(needed)
        else:
            self._touch({tile // self.tiles_per_node for tile in gone | changed})
        self._choose_size()
        self._values = None

    def show(self, settings: ViewSettings) -> None:
        """Show it in another way from now on."""
        if settings == self._settings:
            return
        before, self._settings = self._settings, settings
        if settings.box != before.box:
            self._touch(set(self.marks))
        if (settings.mode, settings.low, settings.high) != (before.mode, before.low, before.high):
            self._values = None
            self._range_ns = -RANGE_NS
            self.paint += 1

    def settle(self, now_ns: int) -> None:
        """Show small changes that waited, and bring range and plane up to date: seldom, as everything is recoloured."""
        self._now_ns = now_ns
        self._touch({node for node, since_ns in self._small.items() if now_ns - since_ns >= SMALL_NS})
        if self._settings.mode == "photograph" or self._values is not None or now_ns - self._range_ns < RANGE_NS:
            return
        self._range_ns = now_ns
        plane = fit_plane(self._tiles.values()) if self._settings.mode == "deviation" else None
        parts = [values_of(tile, self._settings.mode, plane) for tile in sample(self._tiles.values())]
        self._values = np.concatenate(parts) if parts else np.zeros(0, np.float32)
        within = chosen_range(self._settings, self._values)
        if within != self.range or plane != self.plane:
            self.paint += 1
        self.range, self.plane = within, plane

    def prepared(self, node: int, one_of: int) -> NodeData:
        """One node thinned to ``one_of``, clipped and coloured.

        Raises:
            KeyError: there is no such node.
        """
        geometry = self.marks[node]
        known = self._cache.pop((node, one_of), None)
        if known is not None:
            self._cached_bytes -= len(known[3].points) * POINT_BYTES
            if known[:2] == (geometry, self.paint):
                return self._keep((node, one_of), known)
        tile = known[2] if known is not None and known[0] == geometry else self._node_tile(node, one_of)
        colours = colours_of(tile, self._settings.mode, self.range, self.plane)
        return self._keep((node, one_of), (geometry, self.paint, tile, NodeData(tile.xyz, colours)))

    def centre_mm(self, node: int) -> tuple[float, float, float]:
        """About where a node is."""
        first = node * self.tiles_per_node
        for number in range(first, first + self.tiles_per_node):
            if number in self._tiles:
                return self._tiles[number].origin_mm
        return self.origin_mm or (0.0, 0.0, 0.0)

    # ---- inside ----

    def _keep(self, key: tuple[int, int], entry: tuple[int, int, Tile, NodeData]) -> NodeData:
        self._cache[key] = entry
        self._cached_bytes += len(entry[3].points) * POINT_BYTES
        while self._cached_bytes > CACHE_BYTES and len(self._cache) > 1:
            _, dropped = self._cache.popitem(last=False)
            self._cached_bytes -= len(dropped[3].points) * POINT_BYTES
        return entry[3]

    def _node_tile(self, node: int, one_of: int) -> Tile:
        tiles = list(self._members(node))
        shown = merged(tiles, self.origin_mm or (0.0, 0.0, 0.0)).thinned(one_of)
        return shown if self._settings.box is None else shown.inside(self._settings.box)

    def _members(self, node: int) -> Iterable[Tile]:
        first = node * self.tiles_per_node
        for number in range(first, first + self.tiles_per_node):
            tile = self._tiles.get(number)
            if tile is not None and tile.count:
                yield tile

    def _touch(self, nodes: set[int]) -> None:
        for node in sorted(nodes):
            self._small.pop(node, None)
            count = sum(tile.count for tile in self._members(node))
            if count:
                self._geometry += 1
                self.marks[node] = self._geometry
                self.counts[node] = count
            else:
                self.marks.pop(node, None)
                self.counts.pop(node, None)

    def _regroup(self, tiles_per_node: int) -> None:
        self.tiles_per_node = tiles_per_node
        self.marks.clear()
        self.counts.clear()
        self._small.clear()
        self._touch({tile // tiles_per_node for tile in self._tiles})

    def _choose_origin(self) -> None:
        """Coordinates are float32 about a point near the object, so that steps far below 0.1 um survive."""
        first = next((tile.origin_mm for tile in self._tiles.values() if tile.count), None)
        if first is None or (self.origin_mm is not None and math.dist(first, self.origin_mm) < NEAR_MM):
            return
        self.origin_mm = first
        self._touch(set(self.marks))

    def _choose_size(self) -> None:
        """Keep the size of a point in step with the distance of neighbours."""
        spacings = sorted(s for tile in self._tiles.values() if (s := tile.spacing_mm))
        if spacings:
            wanted = POINT_FILL * spacings[len(spacings) // 2]
            if not self._point_mm / RESIZE < wanted < self._point_mm * RESIZE:
                self._point_mm = wanted
