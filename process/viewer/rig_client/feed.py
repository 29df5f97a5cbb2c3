"""What the page knows of the rig: one thread reads status, results and pictures; the newest of each kind counts.

Monitors of the sockets tell which services are there, even silent ones. A gap on the results lane is answered by
subscribing again, upon which the worker sends everything.
"""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import zmq
from numpy.typing import NDArray
from zmq.utils.monitor import recv_monitor_message

from acquire.contract.errors import ProtocolError
from acquire.contract.messaging.lanes import Received
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
from acquire.contract.rig_client.feed import RigFeed, picture_pixels

from .tile import Tile, parse_tiles

POLL_MS = 1000
MAX_BATCH = 64
"""Messages taken from one socket before the other gets its turn."""
RESUBSCRIBE_NS = 1_000_000_000
"""Least time between two requests for a snapshot."""
JOIN_TIMEOUT_S = 5.0
_EVENTS = zmq.EVENT_CONNECTED | zmq.EVENT_DISCONNECTED
_PEERS = {"status": "daemon", "results": "worker"}
"""Which field of :class:`Snapshot` the sender on a lane has."""


@dataclass(frozen=True)
class Peer:
    """What is known of the process at the other end of a lane."""

    connected: bool = False
    heard_ns: int = 0
    """CLOCK_MONOTONIC here when its last message came; 0: none came."""
    changed_ns: int = 0
    """CLOCK_MONOTONIC of the last connection or loss; 0: never was there."""


@dataclass(frozen=True)
class Snapshot:
    """What is known of the rig at one moment, without points and pixels."""

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
class TileChanges:
    """Tiles that changed since they were last taken."""

    reset: bool = False
    """True: forget all tiles that are not in here."""
    tiles: dict[int, Tile] = field(default_factory=dict)


class FeedThread:
    """Listens in a thread of its own; the other methods are safe from any thread."""

    def __init__(self, run_dir: Path, on_change: threading.Event, clock: Clock | None = None) -> None:
        """``on_change`` is set whenever there is something new."""
        self._run_dir, self._on_change = run_dir, on_change
        self._clock = clock or MonotonicClock()
        self._lock = threading.Lock()
        self._now = Snapshot()
        self._changes = TileChanges()
        self._pixels: NDArray[np.uint8] | None = None
        self._misfits = 0
        self._results_from = ("", 0)
        self._asked_ns = -RESUBSCRIBE_NS
        self._watching = self._closing = False
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._thread = threading.Thread(target=self._run, name="viewer-feed")

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    def close(self) -> None:
        """End the thread and close its sockets."""
        self._closing = True
        os.eventfd_write(self._wake, 1)
        self._thread.join(JOIN_TIMEOUT_S)
        os.close(self._wake)

    def snapshot(self) -> Snapshot:
        """The newest state."""
        with self._lock:
            return self._now

    def watch(self, on: bool) -> None:
        """Ask for camera pictures, or no more: the daemon makes none without a subscriber."""
        self._watching = on
        os.eventfd_write(self._wake, 1)

    def take_pixels(self) -> NDArray[np.uint8] | None:
        """The newest camera picture, [h, w] or [h, w, 3] RGB, if there is one since the last call."""
        with self._lock:
            pixels, self._pixels = self._pixels, None
            return pixels

    def take_tiles(self) -> TileChanges:
        """The tiles that changed since the last call; they are the caller's now."""
        with self._lock:
            changes, self._changes = self._changes, TileChanges()
            return changes

    # ---- in the thread ----

    def _run(self) -> None:
        context: zmq.Context[Any] = zmq.Context()
        feed = RigFeed(context)
        # before connecting: a service that is up connects at once
        monitors = {lane: feed.sockets[lane].get_monitor_socket(_EVENTS) for lane in _PEERS}
        try:
            feed.connect(self._run_dir)
            self._listen(feed, monitors)
        finally:
            for lane, monitor in monitors.items():
                feed.sockets[lane].disable_monitor()
                monitor.close(0)
            feed.close()
            context.term()

    def _listen(self, feed: RigFeed, monitors: dict[str, Any]) -> None:
        poller = zmq.Poller()
        for source in (self._wake, *feed.sockets.values(), *monitors.values()):
            poller.register(source, zmq.POLLIN)
        while not self._closing:
            ready = poller.poll(POLL_MS)
            with suppress(BlockingIOError):
                os.eventfd_read(self._wake)
            feed.want_pictures(self._watching)
            for lane, monitor in monitors.items():
                while monitor.poll(0):
                    self._take_presence(_PEERS[lane], recv_monitor_message(monitor)["event"] == zmq.EVENT_CONNECTED)
            for lane in feed.sockets:
                self._drain(feed, lane)
            if ready:
                self._on_change.set()

    def _take_presence(self, peer: str, connected: bool) -> None:
        with self._lock:
            self._update_peer(peer, connected=connected, changed_ns=self._clock.now_ns())

    def _drain(self, feed: RigFeed, lane: str) -> None:
        for received in feed.arrived(lane, MAX_BATCH):
            try:
                if self._take(received):
                    self._ask_for_all(feed)
            except ProtocolError:
                self._misfits += 1
        with self._lock:
            self._update(messages_dropped=feed.unreadable + self._misfits)

    def _ask_for_all(self, feed: RigFeed) -> None:
        """Have the worker send a snapshot; seldom enough not to drown in them."""
        now_ns = self._clock.now_ns()
        if now_ns - self._asked_ns >= RESUBSCRIBE_NS:
            self._asked_ns = now_ns
            feed.resubscribe("results")

    def _take(self, received: Received) -> bool:
        """Take one message; True if something on the results lane went missing before it."""
        message, now_ns = received.message, self._clock.now_ns()
        pixels = picture_pixels(message, received.buffer).copy() if isinstance(message, Picture) else None
        tiles, left_out = parse_tiles(message, received.buffer) if isinstance(message, ResultTiles) else ({}, 0)
        with self._lock:
            if isinstance(message, Status):
                self._update(status=message)
                self._update_peer("daemon", heard_ns=now_ns)
                return False
            if isinstance(message, Picture):
                self._pixels = pixels
                self._update(picture=message, picture_ns=now_ns)
                return False
            if isinstance(message, ResultMaps):  # for the console; counted, so that its number is no gap
                return self._count_gap(message)
            if not isinstance(message, ResultProgress | ResultTiles | ResultEnd):
                raise ProtocolError(f"a {type(message).__name__} does not belong on this lane")
            self._update_peer("worker", heard_ns=now_ns)
            self._take_result(message, tiles, left_out)
            return self._count_gap(message)

    def _update(self, **fields: Any) -> None:
        self._now = replace(self._now, **fields)

    def _update_peer(self, peer: str, **fields: Any) -> None:
        self._update(**{peer: replace(getattr(self._now, peer), **fields)})

    def _count_gap(self, message: Message) -> bool:
        epoch, seq = self._results_from
        self._results_from = (message.epoch, message.seq)
        if message.epoch != epoch or message.seq <= seq + 1:
            return False
        self._update(gaps=self._now.gaps + message.seq - seq - 1)
        return True

    def _take_result(
        self, message: ResultProgress | ResultTiles | ResultEnd, tiles: dict[int, Tile], left_out: int
    ) -> None:
        uid = message.scan_uid
        if uid != self._now.cloud_scan_uid:
            self._changes = TileChanges(reset=True)
            self._update(cloud_scan_uid=uid, cloud_folded_through=-1, progress=None, end=None, points_left_out=0)
        if isinstance(message, ResultProgress):
            self._update(progress=message)
        elif isinstance(message, ResultEnd):
            self._update(end=message)
        else:
            if message.snapshot:
                self._changes = TileChanges(reset=True)
            self._changes.tiles.update(tiles)
            left_out += self._now.points_left_out
            self._update(cloud_folded_through=message.folded_through, points_left_out=left_out)
