"""Puts points into the scene of one browser alone, and files into its downloads; viser itself sends to all alike.

This depends on viser's message classes and on the buffer of a client: pinned, as in :mod:`guarded_server`.
"""

from __future__ import annotations

import mimetypes
import secrets
from collections import deque
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from viser import _messages

from process.viewer.server.rate_meter import RateMeter

PART_BYTES = 256 * 1024
ROOT = "/cloud"


class ViserConnection:
    """The way to one browser; arrays that it is given are shared, and must not change any more."""

    def __init__(self, client: viser.ClientHandle, meter: RateMeter) -> None:
        self._client = client
        self.meter = meter
        self._file_parts: deque[Any] = deque()

    @property
    def rate_bytes_per_s(self) -> float:
        """What the connection was seen to carry."""
        return self.meter.rate_bytes_per_s

    @property
    def eye_mm(self) -> NDArray[np.float64] | None:
        """Where the browser looks from, shape [3]; None if that is not known."""
        return np.asarray(self._client.camera.position, np.float64)

    def idle(self) -> bool:
        """True if everything sent so far has arrived."""
        return not self._buffer().message_from_id and self.meter.idle

    def begin(self, origin_mm: tuple[float, float, float]) -> None:
        """All nodes that follow are about this origin: a frame above them has it as its position.

        Nodes have no pose of their own: a browser that draws slowly applies the pose of a replaced node late, and
        would show it in a wrong place until then.
        """
        with self._buffer().sanctioned_dead_writes():
            self._client.scene.add_frame(ROOT, show_axes=False, position=origin_mm)

    def put(self, node: int, points: NDArray[np.float32], colours: NDArray[np.uint8], size_mm: float) -> None:
        """Show these points under this number, instead of what was there."""
        self._queue(point_message(f"{ROOT}/{node:03d}", points, colours, size_mm))

    def paint(self, node: int, colours: NDArray[np.uint8]) -> None:
        """Give the points of a node other colours: 3 bytes each."""
        self._queue(_messages.SceneNodeUpdateMessage(f"{ROOT}/{node:03d}", {"colors": colours}))

    def resize(self, node: int, size_mm: float) -> None:
        """Draw the points of a node in another size."""
        self._queue(_messages.SceneNodeUpdateMessage(f"{ROOT}/{node:03d}", {"point_size": size_mm}))

    def remove(self, node: int) -> None:
        """Take a node away."""
        self._queue(_messages.RemoveSceneNodeMessage(f"{ROOT}/{node:03d}"))

    @property
    def has_file_parts(self) -> bool:
        """True while parts of a file wait to be sent."""
        return bool(self._file_parts)

    def offer_file(self, filename: str, content: bytes) -> None:
        """Let the browser save a file; it goes in parts, between the points, so that texts are never long behind."""
        parts = [content[start : start + PART_BYTES] for start in range(0, len(content), PART_BYTES)]
        uuid = secrets.token_hex(8)
        kind = mimetypes.guess_type(filename, strict=False)[0] or "application/octet-stream"
        self._file_parts.append(
            _messages.FileTransferStartDownload(
                save_immediately=True,
                transfer_uuid=uuid,
                filename=filename,
                mime_type=kind,
                part_count=len(parts),
                size_bytes=len(content),
            )
        )
        self._file_parts.extend(
            _messages.FileTransferPart(None, transfer_uuid=uuid, part_index=index, content=part)
            for index, part in enumerate(parts)
        )

    def send_file_part(self) -> bool:
        """Send the next part of a file; False if there is none."""
        if not self._file_parts:
            return False
        with self._buffer().sanctioned_dead_writes():
            self._client._websock_connection.queue_message(self._file_parts.popleft())
        return True

    def _buffer(self) -> Any:
        return self._client._websock_connection.get_message_buffer()

    def _queue(self, message: Any) -> None:
        with self._buffer().sanctioned_dead_writes():
            self._client.scene._queue_scene_message(message)


def point_message(
    name: str, points: NDArray[np.float32], colours: NDArray[np.uint8], size_mm: float
) -> _messages.PointCloudMessage:
    """The message that shows points [n, 3] as discs; float16, viser's default, would be wrong by microns."""
    props = _messages.PointCloudProps(
        points=points,
        colors=colours,
        point_size=size_mm,
        point_shape="circle",
        precision="float32",
        scale=1.0,
        point_shading="flat",
    )
    return _messages.PointCloudMessage(name=name, props=props)
