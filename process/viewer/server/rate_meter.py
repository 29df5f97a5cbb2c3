"""The bytes to each browser: counted, bounded per second, and known to have arrived.

A send that returns has only filled buffers; so each large message is followed by a ping, and has arrived when the pong
is back. This depends on internals of viser 1.1.1 and websockets 16.1.1, as :mod:`guarded_server` does.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, MutableMapping
from socket import SO_SNDBUF, SOL_SOCKET
from typing import Any

from acquire.contract.units import NS_PER_S

LARGE_BYTES = 24_000
"""Smaller messages tell nothing about the connection."""
FIRST_RATE = 1_500_000.0
"""Bytes per second that a connection is assumed to carry until it was measured."""
NEWEST_SHARE = 0.4
"""Weight of the newest measurement of the rate."""
BURST_S = 1.0
"""A browser may receive so many seconds' worth of its bound at once."""
RECENT_NS = 2 * NS_PER_S
SEND_BUFFER_BYTES = 256 * 1024
"""Bytes that the kernel may take before a send waits: what lies there is not known to have arrived."""


class RateMeter:
    """What one browser was sent. Its coroutines run in the server's loop; the numbers may be read from any thread."""

    def __init__(self, connection: Any, max_bytes_per_s: float) -> None:
        self._connection = connection
        self._send: Callable[..., Awaitable[None]] = connection.send
        self._max_bytes_per_s = max_bytes_per_s
        self._allowed = BURST_S * max_bytes_per_s
        self._allowed_ns = time.monotonic_ns()
        self._sending = 0
        self._without_pong: dict[int, int] = {}
        self._rate_bytes_per_s = FIRST_RATE
        self._pongs: set[asyncio.Task[None]] = set()
        self._recent: list[tuple[int, int]] = []

    @property
    def rate_bytes_per_s(self) -> float:
        """Of large messages, from the send to the pong; a pong that does not come lowers it all the while."""
        now_ns = time.monotonic_ns()
        waiting = [size * NS_PER_S / max(1, now_ns - begun_ns) for begun_ns, size in list(self._without_pong.items())]
        return min([self._rate_bytes_per_s, self._max_bytes_per_s, *waiting])

    @property
    def idle(self) -> bool:
        """True if nothing is on its way and every ping came back."""
        return not self._sending and not self._without_pong

    def recent_bytes_per_s(self) -> float:
        """Bytes sent per second over the last two seconds."""
        now_ns = time.monotonic_ns()
        recent = sum(size for at_ns, size in list(self._recent) if now_ns - at_ns < RECENT_NS)
        return recent * NS_PER_S / RECENT_NS

    async def send(self, data: Any, *rest: Any, **options: Any) -> None:
        """Instead of the connection's own ``send``."""
        size = len(data) if isinstance(data, bytes | str) else 0
        self._sending += 1
        try:
            await self._wait_for_allowance(size)
            begun_ns = time.monotonic_ns()
            if size >= LARGE_BYTES:
                self._without_pong[begun_ns] = size
            await self._send(data, *rest, **options)
        finally:
            self._sending -= 1
        self._recent = [entry for entry in self._recent[-64:] if begun_ns - entry[0] < RECENT_NS]
        self._recent.append((begun_ns, size))
        if size >= LARGE_BYTES:
            task = asyncio.create_task(self._wait_for_pong(size, begun_ns))
            self._pongs.add(task)
            task.add_done_callback(self._pongs.discard)

    async def _wait_for_allowance(self, size: int) -> None:
        """Token bucket: it fills with the bound; a message larger than the bucket waits until it is full."""
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

    async def _wait_for_pong(self, size: int, begun_ns: int) -> None:
        """Measure the rate; the connection's own keepalive ends a browser that never answers."""
        try:
            await (await self._connection.ping())
            seconds = max(1e-4, (time.monotonic_ns() - begun_ns) / NS_PER_S)
            self._rate_bytes_per_s += NEWEST_SHARE * (size / seconds - self._rate_bytes_per_s)
        except Exception:  # noqa: BLE001 - a connection that ends says so elsewhere; here only its pong is missing
            return
        finally:
            self._without_pong.pop(begun_ns, None)


def metered(
    handler: Callable[[Any], Awaitable[None]], meters: MutableMapping[Any, RateMeter], max_bytes_per_s: float
) -> Callable[[Any], Awaitable[None]]:
    """A websocket handler whose connection sends through a meter, found by the connection in ``meters``."""

    async def handle(connection: Any) -> None:
        socket = connection.transport.get_extra_info("socket")
        if socket is not None:
            socket.setsockopt(SOL_SOCKET, SO_SNDBUF, SEND_BUFFER_BYTES)
        meters[connection] = meter = RateMeter(connection, max_bytes_per_s)
        connection.send = meter.send
        try:
            await handler(connection)
        finally:
            meters.pop(connection, None)

    return handle
