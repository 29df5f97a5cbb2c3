"""What a rig tells of itself: the status, results and preview lanes, read without a thread.

Services may come and go in any order: the sockets connect again by themselves.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import zmq
from numpy.typing import NDArray

from acquire.contract.errors import ProtocolError
from acquire.contract.messaging.lanes import Received, arrived, open_socket
from acquire.contract.messaging.messages import Picture
from acquire.contract.process.run_dir import endpoint

FEED_LANES: Final = ("status", "results", "preview")


class RigFeed:
    """SUB sockets of some lanes; belongs to one thread.

    Messages of another version, or that cannot be read, are counted and passed over: they must not stop a client.
    """

    def __init__(self, context: zmq.Context[Any], *lanes: str) -> None:
        """``lanes``: some of ``FEED_LANES``; none means all."""
        self.sockets: dict[str, zmq.Socket[Any]] = {
            lane: open_socket(context, zmq.SUB, lane) for lane in lanes or FEED_LANES
        }
        self.unreadable = 0
        """Messages that were passed over."""
        self._pictures_wanted = False
        for lane, socket in self.sockets.items():
            if lane != "preview":
                socket.setsockopt(zmq.SUBSCRIBE, b"")

    def connect(self, run_dir: Path) -> None:
        """Begin to listen; apart from the constructor, so that a monitor can be there first.

        Raises:
            ConfigError: the path is too long for a socket.
        """
        for lane, socket in self.sockets.items():
            socket.connect(endpoint(run_dir, lane))

    def want_pictures(self, wanted: bool) -> None:
        """Subscribe to camera pictures, or no longer: the daemon makes none without a subscriber."""
        if wanted != self._pictures_wanted:
            self._pictures_wanted = wanted
            self.sockets["preview"].setsockopt(zmq.SUBSCRIBE if wanted else zmq.UNSUBSCRIBE, b"")

    def resubscribe(self, lane: str) -> None:
        """Subscribe anew: a worker answers on the results lane with a snapshot of everything."""
        self.sockets[lane].setsockopt(zmq.UNSUBSCRIBE, b"")
        self.sockets[lane].setsockopt(zmq.SUBSCRIBE, b"")

    def arrived(self, lane: str, most: int) -> Iterator[Received]:
        """The messages of one lane that are there now, up to ``most``; never waits."""
        yield from arrived(self.sockets[lane], most, self._count)

    def close(self) -> None:
        """Close the sockets."""
        for socket in self.sockets.values():
            socket.close(0)

    def _count(self, _error: ProtocolError) -> None:
        self.unreadable += 1


def picture_pixels(header: Picture, payload: bytes | memoryview) -> NDArray[np.uint8]:
    """The pixels of a camera picture, [h, w] grey or [h, w, 3] RGB; they share the payload's memory.

    Raises:
        ProtocolError: they are not as many as the header says, or have another number of channels than 1 or 3.
    """
    if len(payload) != math.prod(header.shape) or header.shape[2:] not in ([], [3]):
        raise ProtocolError(f"a picture of shape {header.shape} with {len(payload)} bytes")
    return np.frombuffer(payload, np.uint8).reshape(header.shape)
