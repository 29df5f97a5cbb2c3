"""Brings the points to each browser: an overview first, then what is near its eye.

Each browser has a stream of its own, so that a slow one does not hold up the others. A stream sends one step at a
time, and the next when that one has arrived; a browser whose connection cannot keep up gets the thin overview of what
changed, and the rest when there is time. One thread calls everything.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from process.viewer.server.guarded_server import GuardedServer

from .point_nodes import COLOUR_BYTES, POINT_BYTES, PointNodes
from .viser_connection import ViserConnection

STEP_S = 0.4
"""A step is what the connection carries in so many seconds: texts are never behind more than one."""
LEAST_STEP_BYTES = 48_000
MOST_STEP_BYTES = 1_200_000
STEP_NS = 300_000_000
"""Least time between two steps: drawing is what keeps a browser from showing newer texts."""
HURRY_S = 3.0
"""If all that changed would take longer than this in full, it goes as an overview first; new nodes go so already if
they do not fit into one step."""
SLOW_BYTES_PER_S = 400_000.0
"""A connection that carries less than this is called slow."""


@dataclass(frozen=True)
class SentNode:
    """What a browser has of one node."""

    geometry: int
    """Number of the node's change, as :attr:`PointNodes.marks`."""
    paint: int
    one_of: int
    size_mm: float


@dataclass(frozen=True)
class StreamStats:
    """What the page says about one browser's connection."""

    client_id: int
    bytes_per_s: float
    """Sent over the last two seconds."""
    rate_bytes_per_s: float
    """What the connection carries, as far as it was seen."""
    refined: float
    """Share of the cloud that it has in full, 0..1."""

    @property
    def slow(self) -> bool:
        """True if it gets overviews because it cannot keep up."""
        return self.rate_bytes_per_s < SLOW_BYTES_PER_S and self.refined < 1.0


class BrowserStream:
    """Brings one browser up to date, step by step."""

    def __init__(self, connection: ViserConnection) -> None:
        self.connection = connection
        self._sent: dict[int, SentNode] = {}
        self._waiting: dict[int, None] = {}
        self._origin_mm: tuple[float, float, float] | None = None
        self._tiles_per_node = 0
        self._next_ns = 0
        self._sent_a_file_part = False

    def refined(self, nodes: PointNodes) -> float:
        """Share of the nodes that the browser has in full and as they are now, 0..1."""
        if not nodes.marks:
            return 1.0
        fine = nodes.fine
        whole = sum(sent.geometry == nodes.marks.get(node) and sent.one_of <= fine for node, sent in self._sent.items())
        return whole / len(nodes.marks)

    def turn(self, nodes: PointNodes, now_ns: int) -> int:
        """Send the next step if the last one has arrived; returns the bytes of points and colours in it."""
        if not self.connection.idle():
            return 0
        # points and parts of files take turns
        self._sent_a_file_part = not self._sent_a_file_part and self.connection.send_file_part()
        if self._sent_a_file_part or now_ns < self._next_ns:
            return 0
        self._begin_anew(nodes)
        self._clear_away(nodes)
        self._notice(nodes)
        budget = self._step_bytes()
        sent = 0
        for node, one_of in self._jobs(nodes):
            if sent >= budget:
                break
            sent += self._bring(nodes, node, one_of)
        if sent:
            self._next_ns = now_ns + STEP_NS
        return sent

    def _step_bytes(self) -> int:
        return int(min(MOST_STEP_BYTES, max(LEAST_STEP_BYTES, self.connection.rate_bytes_per_s * STEP_S)))

    def _begin_anew(self, nodes: PointNodes) -> None:
        """Forget what was sent if the nodes are about another origin, or other groups of tiles."""
        if (nodes.origin_mm, nodes.tiles_per_node) == (self._origin_mm, self._tiles_per_node):
            return
        for node in self._sent:
            self.connection.remove(node)
        self._sent.clear()
        self._waiting.clear()
        self._tiles_per_node = nodes.tiles_per_node
        if nodes.origin_mm is not None and nodes.origin_mm != self._origin_mm:
            self.connection.begin(nodes.origin_mm)
        self._origin_mm = nodes.origin_mm

    def _clear_away(self, nodes: PointNodes) -> None:
        """What is gone goes first, and costs nothing; so does a new size."""
        for node in [node for node in self._sent if node not in nodes.marks]:
            self.connection.remove(node)
            del self._sent[node]
        for node, sent in self._sent.items():
            size_mm = nodes.size_mm(sent.one_of)
            if size_mm != sent.size_mm:
                self.connection.resize(node, size_mm)
                self._sent[node] = SentNode(sent.geometry, sent.paint, sent.one_of, size_mm)

    def _notice(self, nodes: PointNodes) -> None:
        """Nodes wait in the order in which they changed first: one that changes all the time waits no longer."""
        for node in [node for node in self._waiting if node not in nodes.marks]:
            del self._waiting[node]
        for node, geometry in nodes.marks.items():
            sent = self._sent.get(node)
            if sent is None or sent.geometry != geometry:
                self._waiting.setdefault(node)

    def _jobs(self, nodes: PointNodes) -> Iterator[tuple[int, int]]:
        """Nodes and how thin they are to be sent: what changed, then new colours, then what is still thin."""
        fine, coarse = nodes.fine, nodes.coarse
        new = [node for node in self._waiting if node not in self._sent]
        hurried = self._bytes(nodes, self._waiting) > HURRY_S * self.connection.rate_bytes_per_s
        overview = hurried or self._bytes(nodes, new) > self._step_bytes()
        for node in new:
            yield node, coarse if overview else fine
        for node in [node for node in self._waiting if node in self._sent]:
            yield node, coarse if hurried else fine
        for node, sent in list(self._sent.items()):
            if sent.paint != nodes.paint:
                yield node, sent.one_of
        if overview:
            return  # what is refined now would change again before it has arrived
        thin = [node for node, sent in self._sent.items() if sent.one_of != fine]
        for node in sorted(thin, key=lambda node: self._distance(nodes, node)):
            yield node, fine

    def _bytes(self, nodes: PointNodes, which: Iterable[int]) -> float:
        """What some nodes cost in full."""
        return sum(nodes.counts[node] for node in which) * POINT_BYTES / nodes.fine

    def _distance(self, nodes: PointNodes, node: int) -> float:
        eye = self.connection.eye_mm
        return math.dist(nodes.centre_mm(node), tuple(eye)) if eye is not None else float(node)

    def _bring(self, nodes: PointNodes, node: int, one_of: int) -> int:
        ready, known = nodes.prepared(node, one_of), self._sent.get(node)
        now = SentNode(nodes.marks[node], nodes.paint, one_of, nodes.size_mm(one_of))
        self._waiting.pop(node, None)
        self._sent[node] = now
        if known is not None and (known.geometry, known.one_of) == (now.geometry, now.one_of):
            self.connection.paint(node, ready.colours)
            return len(ready.colours) * COLOUR_BYTES
        self.connection.put(node, ready.points, ready.colours, now.size_mm)
        return len(ready.points) * POINT_BYTES


class BrowserStreams:
    """One stream for each browser that is connected."""

    def __init__(self, server: GuardedServer, nodes: PointNodes) -> None:
        self._server = server
        self.nodes = nodes
        self._streams: dict[int, BrowserStream] = {}

    @property
    def pending(self) -> bool:
        """True while some browser lacks something, points or a file."""
        return any(
            stream.connection.has_file_parts or stream.refined(self.nodes) < 1.0 for stream in self._streams.values()
        )

    def turn(self, now_ns: int) -> None:
        """One step for each browser whose last one has arrived."""
        clients = self._server.get_clients()
        for gone in set(self._streams) - set(clients):
            del self._streams[gone]
        for client_id in set(clients) - set(self._streams):
            meter = self._server.meter_of(client_id)
            if meter is not None:
                self._streams[client_id] = BrowserStream(ViserConnection(clients[client_id], meter))
        for stream in self._streams.values():
            stream.turn(self.nodes, now_ns)

    def offer_file(self, client_id: int, filename: str, content: bytes) -> None:
        """Let one browser save a file; nothing if it is gone."""
        if client_id in self._streams:
            self._streams[client_id].connection.offer_file(filename, content)

    def stats(self) -> list[StreamStats]:
        """One line for each browser."""
        return [
            StreamStats(
                client_id,
                stream.connection.meter.recent_bytes_per_s(),
                stream.connection.rate_bytes_per_s,
                stream.refined(self.nodes),
            )
            for client_id, stream in sorted(self._streams.items())
        ]
