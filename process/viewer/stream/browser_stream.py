"""Owns what one browser has been sent, and decides what it gets next: an overview first, then what is near its eye.

Each browser has a courier of its own, so that a slow one keeps nobody waiting. A courier sends one step at a time, and
the next when that one has arrived; a browser whose link cannot keep up gets the thin overview of what changed, and the
rest when there is time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .point_nodes import COLOUR_BYTES, POINT_BYTES, Cloud

STEP_S = 0.4
"""A step is what the link carries in so many seconds: words are never behind more than one."""
LEAST_STEP_BYTES = 48_000
MOST_STEP_BYTES = 1_200_000
STEP_NS = 300_000_000
"""Least time between two steps: drawing is what keeps a browser from showing newer words."""
HURRY_S = 3.0
"""If all that changed would take longer than this in full, it goes as an overview first; new nodes go so already if
they do not fit into one step."""


class Link(Protocol):
    """The way to one browser."""

    @property
    def rate_bytes_per_s(self) -> float:
        """What the link was seen to carry."""

    @property
    def eye_mm(self) -> NDArray[np.float64] | None:
        """Where the browser looks from, shape [3]; None if it has not said."""

    def idle(self) -> bool:
        """True if everything sent so far has arrived."""

    def begin(self, origin_mm: tuple[float, float, float]) -> None:
        """All nodes that follow are about this origin."""

    def put(self, node: int, points: NDArray[np.float32], colours: NDArray[np.uint8], size_mm: float) -> None:
        """Show these points under this number, instead of what was there."""

    def paint(self, node: int, colours: NDArray[np.uint8]) -> None:
        """Give the points of a node other colours."""

    def resize(self, node: int, size_mm: float) -> None:
        """Draw the points of a node in another size."""

    def remove(self, node: int) -> None:
        """Take a node away."""


@dataclass(frozen=True)
class Sent:
    """What a browser has of one node."""

    geometry: int
    paint: int
    one_of: int
    size_mm: float


class Courier:
    """Brings one browser up to date, step by step. One thread calls everything."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self._sent: dict[int, Sent] = {}
        self._waiting: dict[int, None] = {}
        self._origin_mm: tuple[float, float, float] | None = None
        self._tiles_per_node = 0
        self._next_ns = 0
        self.bytes_queued = 0
        """Of points and colours, since the browser came."""

    @property
    def waiting(self) -> int:
        """Nodes that changed and were not sent yet."""
        return len(self._waiting)

    def refined(self, cloud: Cloud) -> float:
        """Share of the nodes that the browser has in full and as they are now, 0..1."""
        if not cloud.marks:
            return 1.0
        fine = cloud.fine
        whole = sum(sent.geometry == cloud.marks.get(node) and sent.one_of <= fine for node, sent in self._sent.items())
        return whole / len(cloud.marks)

    def turn(self, cloud: Cloud, now_ns: int) -> int:
        """Send the next step if the last one has arrived; returns the bytes of points and colours in it."""
        if now_ns < self._next_ns or not self.link.idle():
            return 0
        self._begin_anew(cloud)
        self._clear_away(cloud)
        self._notice(cloud)
        budget = self._step_bytes()
        sent = 0
        for node, one_of in self._jobs(cloud):
            if sent >= budget:
                break
            sent += self._bring(cloud, node, one_of)
        if sent:
            self._next_ns = now_ns + STEP_NS
            self.bytes_queued += sent
        return sent

    def _step_bytes(self) -> int:
        return int(min(MOST_STEP_BYTES, max(LEAST_STEP_BYTES, self.link.rate_bytes_per_s * STEP_S)))

    def _begin_anew(self, cloud: Cloud) -> None:
        if (cloud.origin_mm, cloud.tiles_per_node) == (self._origin_mm, self._tiles_per_node):
            return
        for node in self._sent:
            self.link.remove(node)
        self._sent.clear()
        self._waiting.clear()
        self._tiles_per_node = cloud.tiles_per_node
        if cloud.origin_mm is not None and cloud.origin_mm != self._origin_mm:
            self.link.begin(cloud.origin_mm)
        self._origin_mm = cloud.origin_mm

    def _clear_away(self, cloud: Cloud) -> None:
        """What is gone goes first, and costs nothing; so does a new size."""
        for node in [node for node in self._sent if node not in cloud.marks]:
            self.link.remove(node)
            del self._sent[node]
        for node, sent in self._sent.items():
            size_mm = cloud.size_mm(sent.one_of)
            if size_mm != sent.size_mm:
                self.link.resize(node, size_mm)
                self._sent[node] = Sent(sent.geometry, sent.paint, sent.one_of, size_mm)

    def _notice(self, cloud: Cloud) -> None:
        """Nodes wait in the order in which they changed first: one that changes all the time waits no longer."""
        for node in [node for node in self._waiting if node not in cloud.marks]:
            del self._waiting[node]
        for node, geometry in cloud.marks.items():
            sent = self._sent.get(node)
            if sent is None or sent.geometry != geometry:
                self._waiting.setdefault(node)

    def _jobs(self, cloud: Cloud) -> Iterator[tuple[int, int]]:
        """Nodes and how thin they are to be sent: what changed, then new colours, then what is still thin."""
        fine, coarse = cloud.fine, cloud.coarse
        new = [node for node in self._waiting if node not in self._sent]
        hurried = self._bytes(cloud, self._waiting) > HURRY_S * self.link.rate_bytes_per_s
        overview = hurried or self._bytes(cloud, new) > self._step_bytes()
        for node in new:
            yield node, coarse if overview else fine
        for node in [node for node in self._waiting if node in self._sent]:
            yield node, coarse if hurried else fine
        for node, sent in list(self._sent.items()):
            if sent.paint != cloud.paint:
                yield node, sent.one_of
        if overview:
            return  # what is refined now would change again before it has arrived
        thin = [node for node, sent in self._sent.items() if sent.one_of != fine]
        for node in sorted(thin, key=lambda node: self._distance(cloud, node)):
            yield node, fine

    def _bytes(self, cloud: Cloud, nodes: Iterable[int]) -> float:
        """What these nodes cost in full."""
        return sum(cloud.counts[node] for node in nodes) * POINT_BYTES / cloud.fine

    def _distance(self, cloud: Cloud, node: int) -> float:
        eye = self.link.eye_mm
        return math.dist(cloud.centre_mm(node), tuple(eye)) if eye is not None else float(node)

    def _bring(self, cloud: Cloud, node: int, one_of: int) -> int:
        ready, known = cloud.prepared(node, one_of), self._sent.get(node)
        size_mm = cloud.size_mm(one_of)
        now = Sent(cloud.marks[node], cloud.paint, one_of, size_mm)
        self._waiting.pop(node, None)
        self._sent[node] = now
        if known is not None and (known.geometry, known.one_of) == (now.geometry, now.one_of):
            self.link.paint(node, ready.colours)
            return len(ready.colours) * COLOUR_BYTES
        self.link.put(node, ready.points, ready.colours, size_mm)
        return len(ready.points) * POINT_BYTES
