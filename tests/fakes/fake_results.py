"""A rig as the viewer and the console see it: real status, results and command sockets, scripted by the test."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zmq
from zmq.utils import garbage

from acquire.contract.messaging.lanes import Sender, bind, receive
from acquire.contract.messaging.messages import (
    Command,
    Picture,
    Reply,
    ResultEnd,
    ResultProgress,
    ResultTiles,
    Status,
    TileHeader,
)
from acquire.contract.messaging.point_record import POINT
from acquire.contract.plan import SweepPlan

PLAN = SweepPlan(first_steps=0, last_steps=1578, steps_per_frame=3, um_per_microstep=3.175)
SCAN_UID = "scan-1"


def hill_tiles(columns: int = 8, rows: int = 6, side: int = 24, *, provisional_from: float = 1.1) -> list[Any]:
    """Tiles of a smooth hill of 10 x 7.5 mm, left to right: a list of (TileHeader, points).

    Points whose x, as a part of the width, is over ``provisional_from`` are provisional.
    """
    return [
        _hill_tile(row * columns + column, column, row, columns, rows, side, provisional_from)
        for column in range(columns)
        for row in range(rows)
    ]


def _hill_tile(tile: int, column: int, row: int, columns: int, rows: int, side: int, provisional_from: float) -> Any:
    u = (column + (np.arange(side) + 0.5) / side) / columns
    v = (row + (np.arange(side) + 0.5) / side) / rows
    u, v = (grid.ravel() for grid in np.meshgrid(u, v))
    x, y = 10 * (u - 0.5), 7.5 * (0.5 - v)
    z = 2.5 * np.exp(-(x**2 + y**2) / 6) + 0.15 * np.cos(3 * x) * np.cos(3 * y) + 0.4
    origin = (float(x.mean()), float(y.mean()), float(z.mean()))
    points = np.zeros(x.size, POINT)
    points["x"], points["y"], points["z"] = x - origin[0], y - origin[1], z - origin[2]
    shade = np.clip(90 + 50 * z, 0, 235).astype(np.uint8)
    points["red"], points["green"], points["blue"] = shade, shade + 12, shade
    points["provisional"] = u > provisional_from
    points["crossing"] = 526 * u
    points["sigma_um"] = 0.2 + 0.6 * v
    return TileHeader(tile, x.size, int(points["provisional"].sum()), origin), points


@dataclass
class FakeRig:
    """Daemon and worker in one thread; what it published last is repeated to whoever comes later."""

    run_dir: Path
    status: Status = field(default_factory=lambda: Status(state="idle", position_trusted=True))
    daemon: bool = True
    worker: bool = True
    refuse: str = ""
    """Not empty: every command is refused with this text."""
    silent_commands: bool = False
    """True: commands are taken and never answered."""
    commands: list[Command] = field(default_factory=list)
    """Each request once, however often it came."""

    def __post_init__(self) -> None:
        self._lock = threading.Lock()
        self._outbox: list[tuple[Any, Any]] = []
        self._tiles: dict[int, Any] = {}
        self._progress: ResultProgress | None = None
        self._read, self._write = os.pipe()
        self._closing = False
        self.commanded = threading.Event()
        self.subscribed = threading.Event()
        """Set once somebody listens to the results: what is published before that reaches nobody."""
        self.watched = threading.Event()
        """Set once somebody looks at the camera's pictures."""
        self.unwatched = threading.Event()
        self.snapshots_sent = 0
        self._thread = threading.Thread(target=self._run, name="fake-rig")
        self._ready = threading.Event()

    def __enter__(self) -> FakeRig:
        self._thread.start()
        assert self._ready.wait(5)
        return self

    def __exit__(self, *_: object) -> None:
        self._closing = True
        os.write(self._write, b"x")
        self._thread.join(5)
        assert not self._thread.is_alive()
        os.close(self._read)
        os.close(self._write)

    def publish(self, message: Any, payload: bytes | None = None) -> None:
        """Send one message on the lane that it belongs to, from the rig's thread."""
        with self._lock:
            self._outbox.append((message, payload))
        os.write(self._write, b"x")

    def set_status(self, **fields: Any) -> None:
        self.status = Status(**fields)
        self.publish(self.status)

    def publish_picture(self, pixels: Any, **fields: Any) -> None:
        """One camera picture, [h, w] or [h, w, 3] uint8."""
        shape = list(pixels.shape)
        self.publish(Picture(shape=shape, source_shape=shape[:2], **fields), pixels.tobytes())

    def publish_tiles(
        self, tiles: list[Any], *, folded_through: int, scan_uid: str = SCAN_UID, message: str = "", skip_seq: int = 0
    ) -> None:
        """Changed tiles and the progress with them; ``skip_seq`` pretends that so many messages were lost before."""
        for header, points in tiles:
            self._tiles[header.tile] = (header, points)
        self.publish(("skip", skip_seq))
        self.publish(*tiles_message(tiles, folded_through, scan_uid, snapshot=False))
        settled = sum(header.count - header.provisional for header, _ in self._tiles.values())
        provisional = sum(header.provisional for header, _ in self._tiles.values())
        self.publish(
            ResultProgress(
                scan_uid=scan_uid,
                version=folded_through + 1,
                folded_through=folded_through,
                expected=PLAN.count,
                points_settled=settled,
                points_provisional=provisional,
                message=message,
            )
        )

    def _run(self) -> None:
        context: zmq.Context[Any] = zmq.Context()
        self._senders: list[Sender] = []
        try:
            self._serve(context)
        finally:
            for sender in self._senders:
                sender.socket.close(0)
            context.term()
            garbage.gc.stop()  # pyzmq's thread that frees what was sent without a copy; it starts again when needed

    def _bind(self, context: Any, kind: int, lane: str) -> Sender:
        self._senders.append(Sender(bind(context, kind, self.run_dir, lane)))
        return self._senders[-1]

    def _serve(self, context: Any) -> None:
        poller = zmq.Poller()
        poller.register(self._read, zmq.POLLIN)
        status = commands = results = preview = None
        if self.daemon:
            status = self._bind(context, zmq.PUB, "status")
            commands = self._bind(context, zmq.ROUTER, "command")
            poller.register(commands.socket, zmq.POLLIN)
            preview = self._bind(context, zmq.XPUB, "preview")
            poller.register(preview.socket, zmq.POLLIN)
        if self.worker:
            results = self._bind(context, zmq.XPUB, "results")
            results.socket.setsockopt(zmq.XPUB_VERBOSE, 1)
            poller.register(results.socket, zmq.POLLIN)
        self._ready.set()
        while not self._closing:
            ready = dict(poller.poll(200))
            if self._read in ready:
                os.read(self._read, 4096)
            if status is not None:
                status.send(self.status)
            if results is not None and results.socket in ready and results.socket.recv() == b"\x01":
                self._send_snapshot(results)
                self.subscribed.set()
            if commands is not None and commands.socket in ready:
                self._answer(commands)
            if preview is not None and preview.socket in ready:
                (self.watched if preview.socket.recv() == b"\x01" else self.unwatched).set()
            for message, payload in self._waiting():
                lane = {Status: status, Picture: preview}.get(type(message), results)
                if isinstance(message, tuple):
                    results.seq += message[1]
                elif lane is not None:
                    lane.send(message, payload)

    def _waiting(self) -> Iterator[tuple[Any, Any]]:
        with self._lock:
            waiting, self._outbox = self._outbox, []
        for message, payload in waiting:
            if isinstance(message, ResultProgress):
                self._progress = message
            yield message, payload

    def _send_snapshot(self, results: Sender) -> None:
        if self._progress is None:
            return
        self.snapshots_sent += 1
        progress = self._progress
        results.send(
            *tiles_message(list(self._tiles.values()), progress.folded_through, progress.scan_uid, snapshot=True)
        )
        results.send(progress)

    def _answer(self, commands: Sender) -> None:
        received = receive(commands.socket)
        if received is None or not isinstance(received.message, Command):
            return
        command = received.message
        if all(command.request_id != known.request_id for known in self.commands):
            self.commands.append(command)
        self.commanded.set()
        if self.silent_commands:
            return
        reply = Reply(request_id=command.request_id, ok=not self.refuse, error=self.refuse)
        commands.send(reply, routing_id=received.routing_id)


def tiles_message(tiles: list[Any], folded_through: int, scan_uid: str, *, snapshot: bool) -> tuple[Any, bytes]:
    """A ResultTiles message and its payload."""
    headers = [header for header, _ in tiles]
    payload = b"".join(points.tobytes() for _, points in tiles)
    message = ResultTiles(
        scan_uid=scan_uid, version=folded_through + 1, folded_through=folded_through, snapshot=snapshot, tiles=headers
    )
    return message, payload


def end_message(points: int, scan_uid: str = SCAN_UID) -> ResultEnd:
    """The word that everything is on disk."""
    return ResultEnd(scan_uid=scan_uid, version=999, outcome="complete", folded_through=PLAN.count - 1, points=points)
