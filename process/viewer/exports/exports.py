"""Own what can be taken away from the page: a cloud as PLY, and one HTML page that works offline.

Both are made here, without a browser; what is shown decides the colours.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from viser import _messages
from viser.infra._async_message_buffer import AsyncMessageBuffer
from viser.infra._infra import WebsockMessageHandler

from process.cloud.ply import VERTEX, point_records, write_ply
from process.viewer.markup import STYLE, html_of, legend_html
from process.viewer.rig_client.tile import Bounds, Tile, bounds_of, merged, power_of_two
from process.viewer.scene.camera_views import DEFAULT_BOUNDS, FOV_RAD, overview
from process.viewer.stream.colouring import FittedPlane, Legend, Look, Range, colours_of
from process.viewer.stream.point_nodes import POINT_FILL

PAGE_POINTS = 500_000
"""6 to 10 MB in one file."""


@dataclass(frozen=True)
class View:
    """What is shown: the points, how, and what is said about them."""

    title: str
    tiles: Mapping[int, Tile]
    look: Look
    within: Range | None
    plane: FittedPlane | None
    legend: Legend | None
    facts: Sequence[tuple[str, str]] = ()
    """Name and value: outcome, frames, settings, digest."""

    def shown(self, most: int) -> Tile:
        """At most about ``most`` of the points, as one tile."""
        tiles = [tile for tile in self.tiles.values() if tile.count]
        bounds = bounds_of(tiles) or DEFAULT_BOUNDS
        centre = bounds.centre
        if not tiles:
            tiles = [_no_points()]
        one = merged(tiles, (float(centre[0]), float(centre[1]), float(centre[2])))
        one = one if self.look.box is None else one.inside(self.look.box)
        return one.thinned(power_of_two(one.count, most))

    def colours(self, tile: Tile) -> NDArray[np.uint8]:
        """As on the page, shape [n, 3]."""
        return colours_of(tile, self.look.mode, self.within, self.plane)


def _no_points() -> Tile:
    none = np.zeros(0, np.float32)
    return Tile(
        (0.0, 0.0, 0.0), np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), np.zeros(0, bool), none, none
    )


def ply_bytes(tiles: Mapping[int, Tile]) -> bytes:
    """All points as cloud.ply; while a scan is live their quality is not known, and 0."""
    parts = [np.zeros(0, VERTEX)]
    for tile in tiles.values():
        quality = 0 if tile.quality is None else tile.quality
        parts.append(
            point_records(
                VERTEX,
                tile.points_mm(),
                tile.rgb,
                sigma_um=tile.sigma_um,
                crossing=tile.crossing,
                quality=quality,
            )
        )
    target = io.BytesIO()
    write_ply(target, np.concatenate(parts))
    return target.getvalue()


# ---- one page ----


class _Tape(WebsockMessageHandler):
    """Records messages for a page; there is no server and no browser."""

    def get_message_buffer(self) -> AsyncMessageBuffer:
        raise AssertionError("a tape sends nothing")


def page_html(view: View) -> str:
    """The cloud in one HTML file, with legend and numbers beside it; opens without a network.

    Source: viser's own offline client, fed from a recording that holds the points.
    """
    tape = _Tape()
    record = tape.get_message_serializer(lambda _message: True)
    tile = view.shown(PAGE_POINTS)
    bounds = tile.bounds or DEFAULT_BOUNDS
    for message in _camera_messages(bounds, tile.origin_mm):
        record._insert_message(message)
    if tile.count:
        record._insert_message(_points_message(tile, view.colours(tile), view.look))
    html = record.as_html(dark_mode=True)
    box = f'{STYLE}<div class="sw-card">{card_html(view, tile.count)}</div>'
    head, body, rest = html.partition("<body>")
    return f"{head}{body}{box}{rest}" if body else f"{html}{box}"


def _camera_messages(bounds: Bounds, origin_mm: tuple[float, float, float]) -> list[_messages.Message]:
    """Where the page looks from; the points stand about zero there."""
    shift = np.asarray(origin_mm)
    pose = overview(bounds)
    eye, target = pose.eye - shift, pose.target - shift

    def triple(vector: NDArray[np.float64]) -> tuple[float, float, float]:
        return (float(vector[0]), float(vector[1]), float(vector[2]))

    return [
        _messages.SetOrientationMessage("", (math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0)),  # z is up
        _messages.SetCameraPositionMessage(triple(eye), initial=True),
        _messages.SetCameraLookAtMessage(triple(target), initial=True),
        _messages.SetCameraUpDirectionMessage((0.0, 0.0, 1.0), initial=True),
        _messages.SetCameraFovMessage(FOV_RAD, initial=True),
        _messages.SetCameraNearMessage(pose.distance_mm / 200, initial=True),
        _messages.SetCameraFarMessage(pose.distance_mm * 50, initial=True),
    ]


def _points_message(tile: Tile, colours: NDArray[np.uint8], look: Look) -> _messages.Message:
    spacing = tile.spacing_mm or 0.01
    props = _messages.PointCloudProps(
        points=tile.xyz,
        colors=colours,
        point_size=POINT_FILL * spacing * look.size_factor,
        point_shape="circle",
        precision="float32",
        scale=1.0,
        point_shading="flat",
    )
    return _messages.PointCloudMessage(name="/cloud", props=props)


def card_html(view: View, shown: int) -> str:
    """Title and facts of an offline page, then its legend; ``shown`` is the number of points in it."""
    facts = [*view.facts, ("Points shown", f"{shown:,}")]
    return html_of("card.html", title=view.title, facts=facts) + legend_html(view.legend)
