"""Owns the wire to each browser: counts its bytes, bounds them per second, and knows when they have arrived.

A send that returns has only filled buffers; so each large message is followed by a ping, and has arrived when the pong
is back. This leans on internals of viser 1.1.1 and websockets 16.1.1, like the door, and is proven by the same tests.
"""

from __future__ import annotations

import asyncio
import mimetypes
import secrets
import time
from collections import deque
from collections.abc import Awaitable, Callable, MutableMapping
from socket import SO_SNDBUF, SOL_SOCKET
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from viser import _messages

from acquire.contract.units import NS_PER_S

LARGE_BYTES = 24_000
"""Smaller messages tell nothing about the link."""
FIRST_RATE = 1_500_000.0
"""Bytes per second that a link is believed to carry until it was measured."""
NEWEST_SHARE = 0.4
"""Weight of the newest measurement of the rate."""
BURST_S = 1.0
"""A browser may receive so many seconds' worth of its bound at once."""
SEND_BUFFER_BYTES = 256 * 1024
"""Bytes that the kernel may hide from us."""
PART_BYTES = 256 * 1024
ROOT = "/cloud"


class Meter:
    """What one browser was sent. Its coroutines run in the server's loop; the numbers may be read from any thread."""

    def __init__(self, connection: Any, max_bytes_per_s: float) -> None:
        self._connection = connection
        self._send: Callable[..., Awaitable[None]] = connection.send
        self._max_bytes_per_s = max_bytes_per_s
        self._allowed = BURST_S * max_bytes_per_s
        self._allowed_ns = time.monotonic_ns()
        self._sending = 0
        self._unheard: dict[int, int] = {}
        self._rate_bytes_per_s = FIRST_RATE
        self._pongs: set[asyncio.Task[None]] = set()
        self._recent: list[tuple[int, int]] = []
        self.sent_bytes = 0
        """Of websocket messages that were given to the kernel."""

    @property
    def rate_bytes_per_s(self) -> float:
        """Of large messages, from the send to the pong; a pong that does not come lowers it all the while."""
        now_ns = time.monotonic_ns()
        waiting = [size * NS_PER_S / max(1, now_ns - begun_ns) for begun_ns, size in list(self._unheard.items())]
        return min([self._rate_bytes_per_s, self._max_bytes_per_s, *waiting])

    @property
    def idle(self) -> bool:
        """True if nothing is on its way and every ping came back."""
        return not self._sending and not self._unheard

    def recent_bytes_per_s(self) -> float:
        """Bytes sent per second over the last two seconds."""
        now_ns = time.monotonic_ns()
        return sum(size for at_ns, size in list(self._recent) if now_ns - at_ns < 2 * NS_PER_S) / 2

    async def send(self, data: Any, *rest: Any, **options: Any) -> None:
        """Instead of the connection's own ``send``."""
        size = len(data) if isinstance(data, bytes | str) else 0
        self._sending += 1
        try:
            await self._wait_for_allowance(size)
            begun_ns = time.monotonic_ns()
            if size >= LARGE_BYTES:
                self._unheard[begun_ns] = size
            await self._send(data, *rest, **options)
        finally:
            self._sending -= 1
        self.sent_bytes += size
        self._recent = [entry for entry in self._recent[-64:] if begun_ns - entry[0] < 2 * NS_PER_S]
        self._recent.append((begun_ns, size))
        if size >= LARGE_BYTES:
            task = asyncio.create_task(self._hear(size, begun_ns))
            self._pongs.add(task)
            task.add_done_callback(self._pongs.discard)

    async def _wait_for_allowance(self, size: int) -> None:
        """Spend from an account that fills with the bound; a message larger than the account waits until it is full."""
        most = BURST_S * self._max_bytes_per_s
        while True:
            now_ns = time.monotonic_ns()
            gained = (now_ns - self._allowed_ns) / NS_PER_S * self._max_bytes_per_s
            self._allowed, self._allowed_ns = min(most, self._allowed + gained), now_ns
            missing = min(size, most) - self._allowed
            if missing <= 0:
                self._allowed -= size
                return
            await asyncio.sleep(missing / self._max_bytes_per_s)

    async def _hear(self, size: int, begun_ns: int) -> None:
        """Wait for the pong; the connection's own keepalive ends a browser that never answers."""
        try:
            await (await self._connection.ping())
            seconds = max(1e-4, (time.monotonic_ns() - begun_ns) / NS_PER_S)
            self._rate_bytes_per_s += NEWEST_SHARE * (size / seconds - self._rate_bytes_per_s)
        except Exception:  # noqa: BLE001 - a connection that ends says so elsewhere; here only its pong is missing
            return
        finally:
            self._unheard.pop(begun_ns, None)


def metered(
    handler: Callable[[Any], Awaitable[None]], meters: MutableMapping[Any, Meter], max_bytes_per_s: float
) -> Callable[[Any], Awaitable[None]]:
    """A websocket handler whose connection sends through a meter, found by the connection in ``meters``."""

    async def handle(connection: Any) -> None:
        socket = connection.transport.get_extra_info("socket")
        if socket is not None:
            socket.setsockopt(SOL_SOCKET, SO_SNDBUF, SEND_BUFFER_BYTES)
        meters[connection] = meter = Meter(connection, max_bytes_per_s)
        connection.send = meter.send
        try:
            await handler(connection)
        finally:
            meters.pop(connection, None)

    return handle


class BrowserLink:
    """Puts nodes into the scene of one browser alone; what it is given is shared, never changed."""

    def __init__(self, client: viser.ClientHandle, meter: Meter) -> None:
        self._client = client
        self.meter = meter
        self._parcels: deque[Any] = deque()

    @property
    def rate_bytes_per_s(self) -> float:
        """What the link was seen to carry."""
        return self.meter.rate_bytes_per_s

    @property
    def eye_mm(self) -> NDArray[np.float64] | None:
        """Where the browser looks from."""
        return np.asarray(self._client.camera.position, np.float64)

    def idle(self) -> bool:
        """True if everything sent so far has arrived."""
        waiting = self._client._websock_connection.get_message_buffer().message_from_id
        return not waiting and self.meter.idle

    def begin(self, origin_mm: tuple[float, float, float]) -> None:
        """The frame that carries the origin.

        Nodes have no pose of their own: a browser that draws slowly applies the pose of a replaced node late, and
        would show it in a wrong place until then.
        """
        with self._buffer().sanctioned_dead_writes():
            self._client.scene.add_frame(ROOT, show_axes=False, position=origin_mm)

    def put(self, node: int, points: NDArray[np.float32], colours: NDArray[np.uint8], size_mm: float) -> None:
        """One message; float16, viser's default, errs by microns."""
        props = _messages.PointCloudProps(
            points=points,
            colors=colours,
            point_size=size_mm,
            point_shape="circle",
            precision="float32",
            scale=1.0,
            point_shading="flat",
        )
        self._queue(_messages.PointCloudMessage(name=_name(node), props=props))

    def paint(self, node: int, colours: NDArray[np.uint8]) -> None:
        """Colours alone, 3 bytes each."""
        self._queue(_messages.SceneNodeUpdateMessage(_name(node), {"colors": colours}))

    def resize(self, node: int, size_mm: float) -> None:
        """The size alone."""
        self._queue(_messages.SceneNodeUpdateMessage(_name(node), {"point_size": size_mm}))

    def remove(self, node: int) -> None:
        """Take a node away."""
        self._queue(_messages.RemoveSceneNodeMessage(_name(node)))

    @property
    def posting(self) -> bool:
        """True while parts of a file wait."""
        return bool(self._parcels)

    def post(self, filename: str, content: bytes) -> None:
        """Let the browser save a file; it goes in parts, between the points, so that words are never long behind."""
        parts = [content[start : start + PART_BYTES] for start in range(0, len(content), PART_BYTES)]
        uuid = secrets.token_hex(8)
        kind = mimetypes.guess_type(filename, strict=False)[0] or "application/octet-stream"
        self._parcels.append(
            _messages.FileTransferStartDownload(
                save_immediately=True,
                transfer_uuid=uuid,
                filename=filename,
                mime_type=kind,
                part_count=len(parts),
                size_bytes=len(content),
            )
        )
        self._parcels.extend(
            _messages.FileTransferPart(None, transfer_uuid=uuid, part_index=index, content=part)
            for index, part in enumerate(parts)
        )

    def post_part(self) -> bool:
        """Send the next part of what was posted; False if there is none."""
        if not self._parcels:
            return False
        with self._buffer().sanctioned_dead_writes():
            self._client._websock_connection.queue_message(self._parcels.popleft())
        return True

    def _buffer(self) -> Any:
        return self._client._websock_connection.get_message_buffer()

    def _queue(self, message: Any) -> None:
        with self._buffer().sanctioned_dead_writes():
            self._client.scene._queue_scene_message(message)


def _name(node: int) -> str:
    return f"{ROOT}/{node:03d}"
