"""Owns the viewer's ear on the rig: one thread with the status and results sockets; the newest word always wins.

Services come and go in any order: the sockets reconnect by themselves, monitors say who is there, and a gap on the
results lane is answered by subscribing again, upon which the worker sends everything.
"""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import zmq
from numpy.typing import NDArray
from zmq.utils.monitor import recv_monitor_message

from acquire.contract.errors import ProtocolError
from acquire.contract.messaging.lanes import Received, open_socket, receive
from acquire.contract.messaging.messages import (
    Message,
    Picture,
    ResultEnd,
    ResultMaps,
    ResultProgress,
    ResultTiles,
    Status,
)
from acquire.contract.process.clocks import Clock, MonotonicClock
from acquire.contract.process.run_dir import endpoint

from .payloads import pixels_of, points_of
from .tile import Tile

POLL_MS = 1000
RECONNECT_MS = 50
RECONNECT_MAX_MS = 500
MAX_BATCH = 64
"""Messages taken from one socket before the other gets its turn."""
RESUBSCRIBE_NS = 1_000_000_000
"""Least time between two requests for a snapshot."""
JOIN_TIMEOUT_S = 5.0
_STOP, _WATCH, _LEAVE = b"x", b"w", b"l"
_EVENTS = zmq.EVENT_CONNECTED | zmq.EVENT_DISCONNECTED


@dataclass(frozen=True)
class Peer:
    """What is known of the process at the other end of a lane."""

    connected: bool = False
    heard_ns: int = 0
    """CLOCK_MONOTONIC of its last message here; 0: never heard."""
    changed_ns: int = 0
    """CLOCK_MONOTONIC of the last connection or loss; 0: never was there."""


@dataclass(frozen=True)
class Snapshot:
    """Everything that the page says in words, at one moment."""

    daemon: Peer = Peer()
    worker: Peer = Peer()
    status: Status | None = None
    progress: ResultProgress | None = None
    end: ResultEnd | None = None
    cloud_scan_uid: str = ""
    """The scan that the shown points belong to; empty before the first."""
    cloud_folded_through: int = -1
    """The last frame that the newest tiles contain."""
    messages_dropped: int = 0
    """Messages that could not be read."""
    gaps: int = 0
    """Messages of the results lane that went missing."""
    points_left_out: int = 0
    """Points that were not finite."""
    picture: Picture | None = None
    """The newest camera picture without its pixels; None before the first."""
    picture_ns: int = 0
    """CLOCK_MONOTONIC here when it came."""


@dataclass
class TileNews:
    """Tiles that changed since they were last taken."""

    reset: bool = False
    """True: forget all tiles that are not in here."""
    tiles: dict[int, Tile] = field(default_factory=dict)


class Feed:
    """Listens in a thread of its own; :meth:`snapshot` and :meth:`take_tiles` are safe from any thread."""

    def __init__(self, run_dir: Path, wake: threading.Event, clock: Clock | None = None) -> None:
        """``wake`` is set whenever there is something new."""
        self._run_dir = run_dir
        self._wake = wake
        self._clock = clock or MonotonicClock()
        self._lock = threading.Lock()
        self._now = Snapshot()
        self._news = TileNews()
        self._results_from = ("", 0)
        self._asked_ns = -RESUBSCRIBE_NS
        self._watching = False
        self._pixels: NDArray[np.uint8] | None = None
        self._stop_read, self._stop_write = os.pipe()
        self._thread = threading.Thread(target=self._run, name="viewer-feed")

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    def close(self) -> None:
        """End the thread and close its sockets."""
        os.write(self._stop_write, _STOP)
        self._thread.join(JOIN_TIMEOUT_S)
        os.close(self._stop_write)
        os.close(self._stop_read)

    def snapshot(self) -> Snapshot:
        """The newest state."""
        with self._lock:
            return self._now

    def watch(self, on: bool) -> None:
        """Ask for camera pictures, or no more: the daemon makes none that nobody looks at."""
        os.write(self._stop_write, _WATCH if on else _LEAVE)

    def take_pixels(self) -> NDArray[np.uint8] | None:
        """The newest camera picture, [h, w] or [h, w, 3] RGB, if there is one since the last call."""
        with self._lock:
            pixels, self._pixels = self._pixels, None
            return pixels

    def take_tiles(self) -> TileNews:
        """The tiles that changed since the last call; they are the caller's now."""
        with self._lock:
            news, self._news = self._news, TileNews()
            return news

    def _run(self) -> None:
        context: zmq.Context[Any] = zmq.Context()
        try:
            status, status_monitor = self._subscribe(context, "status")
            results, results_monitor = self._subscribe(context, "results")
            preview = open_socket(context, zmq.SUB, "preview")
            preview.connect(endpoint(self._run_dir, "preview"))
            monitors = {"status": status_monitor, "results": results_monitor}
            try:
                self._listen((status, results, preview), monitors)
            finally:
                preview.close(0)
                for socket in (status, results):
                    socket.disable_monitor()
                    socket.close(0)
                for monitor in monitors.values():
                    monitor.close(0)
        finally:
            context.term()

    def _subscribe(self, context: Any, lane: str) -> tuple[Any, Any]:
        """A connected SUB socket and its monitor, which is there first: a service that is up connects at once."""
        socket = open_socket(context, zmq.SUB, lane)
        monitor = socket.get_monitor_socket(_EVENTS)
        socket.setsockopt(zmq.SUBSCRIBE, b"")
        socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
        socket.setsockopt(zmq.RECONNECT_IVL_MAX, RECONNECT_MAX_MS)
        socket.connect(endpoint(self._run_dir, lane))
        return socket, monitor

    def _listen(self, lanes: tuple[Any, Any, Any], monitors: dict[str, Any]) -> None:
        poller = zmq.Poller()
        for source in (self._stop_read, *lanes, *monitors.values()):
            poller.register(source, zmq.POLLIN)
        while True:
            ready = dict(poller.poll(POLL_MS))
            if self._stop_read in ready and not self._obey(lanes[2]):
                return
            for lane, monitor in monitors.items():
                while monitor in ready and monitor.poll(0):
                    self._on_peer(lane, recv_monitor_message(monitor)["event"] == zmq.EVENT_CONNECTED)
            for socket in lanes:
                if socket in ready:
                    self._drain(socket)
            if ready:
                self._wake.set()

    def _obey(self, preview: Any) -> bool:
        """Read what other threads asked for; False to stop."""
        asked = os.read(self._stop_read, 64)
        if _STOP in asked:
            return False
        watched = asked[-1:] == _WATCH
        if watched != self._watching:
            self._watching = watched
            preview.setsockopt(zmq.SUBSCRIBE if watched else zmq.UNSUBSCRIBE, b"")
        return True

    def _on_peer(self, lane: str, connected: bool) -> None:
        with self._lock:
            name = "daemon" if lane == "status" else "worker"
            peer = replace(getattr(self._now, name), connected=connected, changed_ns=self._clock.now_ns())
            self._now = replace(self._now, **{name: peer})

    def _drain(self, socket: Any) -> None:
        for _ in range(MAX_BATCH):
            try:
                received = receive(socket)
                if received is None:
                    return
                if self._on_message(received):
                    self._ask_for_all(socket)
            except ProtocolError:
                with self._lock:
                    self._now = replace(self._now, messages_dropped=self._now.messages_dropped + 1)

    def _ask_for_all(self, results: Any) -> None:
        """Subscribe anew, upon which the worker sends a snapshot; seldom enough not to drown in them."""
        now_ns = self._clock.now_ns()
        if now_ns - self._asked_ns < RESUBSCRIBE_NS:
            return
        self._asked_ns = now_ns
        results.setsockopt(zmq.UNSUBSCRIBE, b"")
        results.setsockopt(zmq.SUBSCRIBE, b"")

    def _on_message(self, received: Received) -> bool:
        """Take one message; True if something went missing before it."""
        message, now_ns = received.message, self._clock.now_ns()
        if isinstance(message, Status):
            with self._lock:
                self._now = replace(self._now, status=message, daemon=replace(self._now.daemon, heard_ns=now_ns))
            return False
        if isinstance(message, ResultMaps):  # for the console; it is counted, so that its number is no gap
            with self._lock:
                return self._count_gap(message)
        if isinstance(message, Picture):
            pixels = pixels_of(received, message)
            with self._lock:
                self._pixels = pixels
                self._now = replace(self._now, picture=message, picture_ns=now_ns)
            return False
        if not isinstance(message, ResultProgress | ResultTiles | ResultEnd):
            raise ProtocolError(f"a {type(message).__name__} does not belong on this lane")
        tiles, left_out = points_of(received)
        with self._lock:
            gap = self._count_gap(message)
            self._now = replace(self._now, worker=replace(self._now.worker, heard_ns=now_ns))
            self._on_result(message, tiles, left_out)
        return gap

    def _count_gap(self, message: Message) -> bool:
        epoch, seq = self._results_from
        self._results_from = (message.epoch, message.seq)
        if message.epoch != epoch or message.seq <= seq + 1:
            return False
        self._now = replace(self._now, gaps=self._now.gaps + message.seq - seq - 1)
        return True

    def _on_result(
        self, message: ResultProgress | ResultTiles | ResultEnd, tiles: dict[int, Tile], left_out: int
    ) -> None:
        if message.scan_uid != self._now.cloud_scan_uid:
            self._news = TileNews(reset=True)
            self._now = replace(
                self._now,
                cloud_scan_uid=message.scan_uid,
                cloud_folded_through=-1,
                progress=None,
                end=None,
                points_left_out=0,
            )
        if isinstance(message, ResultProgress):
            self._now = replace(self._now, progress=message)
        elif isinstance(message, ResultEnd):
            self._now = replace(self._now, end=message)
        else:
            if message.snapshot:
                self._news = TileNews(reset=True)
            self._news.tiles.update(tiles)
            self._now = replace(
                self._now,
                cloud_folded_through=message.folded_through,
                points_left_out=self._now.points_left_out + left_out,
            )
