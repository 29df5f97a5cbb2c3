"""Owns the cloud in the scene: a fixed set of nodes, each a few tiles; only nodes with changed tiles are sent.

All nodes hang on one frame that carries the origin, and have no pose of their own: a browser that draws slowly applies
the pose of a replaced node late, and would show tiles in wrong places until then.
"""

from __future__ import annotations

import math
from collections import OrderedDict

import viser

from .feed import TileNews
from .tiles import Bounds, Tile, bounds_of, merged, power_of_two

MAX_NODES = 256
"""Thousands of nodes choke the page: with more tiles than this, neighbours share a node."""
POINTS_PER_TURN = 80_000
"""Points sent at once; the rest follows in the next turn, oldest change first (15 bytes each on the wire)."""
POINT_FILL = 1.25
"""Diameter of a drawn point in units of the distance of neighbours: no gaps, no clutter."""
RESIZE = 1.25
"""Points are drawn in another size only if it differs by this factor."""
NEAR_MM = 100.0
"""Within this distance of the origin float32 steps are below 0.01 um."""
DEFAULT_POINT_MM = 0.02


class Cloud:
    """Mirrors the worker's tiles into viser nodes within the budget of points."""

    def __init__(self, server: viser.ViserServer, max_points: int) -> None:
        self._scene = server.scene
        self._max_points = max_points
        self._tiles: dict[int, Tile] = {}
        self._nodes: dict[int, viser.PointCloudHandle] = {}
        self._dirty: OrderedDict[int, None] = OrderedDict()
        self._tiles_per_node = 1
        self._origin_mm: tuple[float, float, float] | None = None
        self._point_mm = DEFAULT_POINT_MM
        self.size_factor = 1.0
        """The operator's choice, multiplied onto the size of a point."""
        self.keep_one_of = 1
        """1: all points are shown; n: one of n, spread evenly."""

    @property
    def points(self) -> int:
        """Number of points of all tiles, shown or not."""
        return sum(tile.count for tile in self._tiles.values())

    @property
    def pending(self) -> int:
        """Nodes that wait to be sent."""
        return len(self._dirty)

    def bounds(self) -> Bounds | None:
        """A box around nearly all points, None without any."""
        return bounds_of(self._tiles.values())

    def take(self, news: TileNews) -> None:
        """Note what changed; nothing is sent before :meth:`draw`."""
        if news.reset:
            gone = {number: tile for number, tile in self._tiles.items() if number not in news.tiles}
            self._touch(gone)
            for number in gone:
                self._dirty.move_to_end(number // self._tiles_per_node, last=False)  # what is gone, goes first
            self._tiles.clear()
        self._tiles.update(news.tiles)
        self._set_origin()
        self._touch(news.tiles)
        needed = power_of_two(max(self._tiles, default=0) + 1, MAX_NODES)
        if needed > self._tiles_per_node:
            self._regroup(needed)
        keep_one_of = power_of_two(self.points, self._max_points)
        if keep_one_of != self.keep_one_of:
            self.keep_one_of = keep_one_of
            self._touch(self._tiles)

    def draw(self) -> int:
        """Send changed nodes up to the budget of one turn; returns the number of points sent."""
        self._resize()
        sent = 0
        while self._dirty and sent < POINTS_PER_TURN:
            node, _ = self._dirty.popitem(last=False)
            sent += self._draw_node(node)
        return sent

    def _resize(self) -> None:
        """Keep the size of a point in step with the distance of neighbours, without resending the points."""
        spacings = sorted(s for tile in self._tiles.values() if (s := tile.spacing_mm))
        if spacings:
            wanted = POINT_FILL * spacings[len(spacings) // 2]
            if not self._point_mm / RESIZE < wanted < self._point_mm * RESIZE:
                self._point_mm = wanted
        for node in self._nodes.values():
            if node.point_size != self._drawn_mm():
                node.point_size = self._drawn_mm()

    def _set_origin(self) -> None:
        """Coordinates are float32 about a point near the object, so that steps far below 0.1 um survive."""
        first = next((tile.origin_mm for tile in self._tiles.values() if tile.count), None)
        if first is None or (self._origin_mm is not None and math.dist(first, self._origin_mm) < NEAR_MM):
            return
        self._origin_mm = first
        self._remove_nodes()
        self._scene.add_frame("/cloud", show_axes=False, position=first)
        self._touch(self._tiles)

    def _remove_nodes(self) -> None:
        for node in self._nodes.values():
            node.remove()
        self._nodes.clear()
        self._dirty.clear()

    def _touch(self, tiles: dict[int, Tile]) -> None:
        for tile in tiles:
            self._dirty[tile // self._tiles_per_node] = None

    def _regroup(self, tiles_per_node: int) -> None:
        self._remove_nodes()
        self._tiles_per_node = tiles_per_node
        self._touch(self._tiles)

    def _draw_node(self, node: int) -> int:
        first = node * self._tiles_per_node
        numbers = range(first, first + self._tiles_per_node)
        tiles = [tile for number in numbers if (tile := self._tiles.get(number)) is not None and tile.count]
        if not tiles or self._origin_mm is None:
            gone = self._nodes.pop(node, None)
            if gone is not None:
                gone.remove()
            return 0
        shown = merged(tiles, self._origin_mm).thinned(self.keep_one_of)
        self._nodes[node] = self._scene.add_point_cloud(
            f"/cloud/{node:03d}",
            points=shown.xyz,
            colors=shown.shown_rgb(),
            point_size=self._drawn_mm(),
            point_shape="circle",
            point_shading="flat",
            precision="float32",  # the default, float16, errs by microns
        )
        return shown.count

    def _drawn_mm(self) -> float:
        return self._point_mm * self.size_factor * self.keep_one_of**0.5
