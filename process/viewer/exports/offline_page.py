"""The shown cloud as one HTML file that opens without a network: viser's own offline client with a recording in it."""

from __future__ import annotations

import math

import numpy as np
from viser import _messages
from viser.infra._async_message_buffer import AsyncMessageBuffer
from viser.infra._infra import WebsockMessageHandler

from process.viewer.rig_client.tile import BoundingBox
from process.viewer.scene.camera_views import DEFAULT_BOUNDS, FOV_RAD, overview
from process.viewer.status_html import STYLE, html_of, legend_html
from process.viewer.stream.point_nodes import POINT_FILL
from process.viewer.stream.viser_connection import point_message

from .shown_cloud import ShownCloud

PAGE_POINTS = 500_000
"""6 to 10 MB in one file."""


class _Recorder(WebsockMessageHandler):
    """Records messages for a page; there is no server and no browser."""

    def get_message_buffer(self) -> AsyncMessageBuffer:
        raise AssertionError("a recorder sends nothing")


def page_html(shown: ShownCloud) -> str:
    """The cloud, with legend and numbers beside it."""
    record = _Recorder().get_message_serializer(lambda _message: True)
    tile = shown.thinned(PAGE_POINTS)
    for message in _camera_messages(tile.bounds or DEFAULT_BOUNDS, tile.origin_mm):
        record._insert_message(message)
    if tile.count:
        size_mm = POINT_FILL * (tile.spacing_mm or 0.01) * shown.settings.size_factor
        record._insert_message(point_message("/cloud", tile.xyz, shown.colours(tile), size_mm))
    html = record.as_html(dark_mode=True)
    card = f'{STYLE}<div class="sw-card">{card_html(shown, tile.count)}</div>'
    head, body, rest = html.partition("<body>")
    return f"{head}{body}{card}{rest}" if body else f"{html}{card}"


def _camera_messages(bounds: BoundingBox, origin_mm: tuple[float, float, float]) -> list[_messages.Message]:
    """Where the page looks from; the points stand about zero there."""
    pose = overview(bounds)
    eye, target = pose.eye - np.asarray(origin_mm), pose.target - np.asarray(origin_mm)
    return [
        _messages.SetOrientationMessage("", (math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0)),  # z is up
        _messages.SetCameraPositionMessage((float(eye[0]), float(eye[1]), float(eye[2])), initial=True),
        _messages.SetCameraLookAtMessage((float(target[0]), float(target[1]), float(target[2])), initial=True),
        _messages.SetCameraUpDirectionMessage((0.0, 0.0, 1.0), initial=True),
        _messages.SetCameraFovMessage(FOV_RAD, initial=True),
        _messages.SetCameraNearMessage(pose.distance_mm / 200, initial=True),
        _messages.SetCameraFarMessage(pose.distance_mm * 50, initial=True),
    ]


def card_html(shown: ShownCloud, points: int) -> str:
    """Title and facts, then the legend; ``points`` is the number of points in the page."""
    facts = [*shown.facts, ("Points shown", f"{points:,}")]
    return html_of("card.html", title=shown.title, facts=facts) + legend_html(shown.legend)
