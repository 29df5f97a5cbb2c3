"""What the worker publishes on the results lane: progress, tiles, maps, the end; a new subscriber gets all of it."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import zmq
from numpy.typing import NDArray

from acquire.contract.messaging.lanes import Sender
from acquire.contract.messaging.messages import (
    FrameFormat,
    ResultEnd,
    ResultMaps,
    ResultProgress,
    ResultTiles,
    TileHeader,
)
from acquire.contract.units import NS_PER_MS, NS_PER_S
from process.cloud.cloud import PointCloud

from .live_maps import MapSamples
from .live_tiles import LiveTiles

PROGRESS_NS = 100 * NS_PER_MS
HEARTBEAT_NS = NS_PER_S
MAPS_NS = NS_PER_S
PREVIEW_NS = 250 * NS_PER_MS
REST = 3
"""Previews rest for so many times what the last one cost: at most a quarter of the time goes into them ..."""
REST_BEHIND, BEHIND_FRAMES = 15, 32
"""... and a sixteenth while the fold is so many frames behind: it comes first ..."""
PREVIEW_BEHIND_NS = 1000 * NS_PER_MS
"""... and one preview each second is enough to see that it goes on."""
_SUBSCRIBED, _UNSUBSCRIBED = b"\x01", b"\x00"


class ResultPublisher:
    """The worker's XPUB socket, and the messages that a later subscriber needs. Not thread-safe."""

    def __init__(self, socket: zmq.Socket[Any]) -> None:
        """``socket`` is bound; every subscription is reported, not only the first."""
        socket.setsockopt(zmq.XPUB_VERBOSE, 1)
        self.socket = socket
        self._sender = Sender(socket)
        self._scan_uid, self._contrast, self._bit_depth = "", 0.0, 8
        self._folded_through, self._version = -1, 0
        self._tiles: LiveTiles | None = None
        self._progress = ResultProgress(version=0, folded_through=-1, expected=0, message="no scan yet")
        self._maps: tuple[ResultMaps, bytes] | None = None
        self.end: ResultEnd | None = None
        """The end of the scan as it was published; None before."""
        self._progress_ns = self._maps_ns = self._preview_ns = self._preview_cost_ns = 0
        self._watched = False
        self.dropped = 0
        """Messages that found a full queue."""

    def begin(self, scan_uid: str, form: FrameFormat, contrast: int) -> None:
        """A new scan: what was published before is forgotten. ``contrast`` in counts of 8 bit."""
        self._scan_uid, self._bit_depth = scan_uid, form.bit_depth
        self._contrast, self._folded_through = float(contrast * 2 ** (form.bit_depth - 8)), -1
        self._tiles, self._maps, self.end = LiveTiles(form.width, form.height), None, None
        self._progress_ns = self._maps_ns = self._preview_ns = self._preview_cost_ns = 0
        self._send_tiles(*self._tiles.snapshot(), snapshot=True)

    def refuse(self, scan_uid: str, why: str) -> None:
        """A scan that cannot be folded; repeated with every heartbeat."""
        self._tiles, self._maps, self.end = None, None, None
        self._progress = ResultProgress(scan_uid=scan_uid, version=0, folded_through=-1, expected=0, message=why)
        self._progress_ns = 0

    def answer_newcomers(self, progress: ResultProgress | None = None) -> bool:
        """Publish everything again for a new subscription (a client subscribes again after a gap); True if so.

        ``progress`` is how far the fold is now; None repeats the last.
        """
        asked = False
        while True:
            try:
                subscription = self.socket.recv(zmq.NOBLOCK)[:1]
            except zmq.Again:
                break
            asked |= subscription == _SUBSCRIBED
            self._watched = subscription != _UNSUBSCRIBED  # sent when the last one leaves
        if asked:
            self._progress = progress or self._progress
            self._send(self._progress)
            if self._tiles is not None:
                self._send_tiles(*self._tiles.snapshot(), snapshot=True)
            if self._maps is not None:
                self._send(*self._maps)
            if self.end is not None:
                self._send(self.end)
        return asked

    def progress_due(self, now_ns: int, *, changed: bool) -> bool:
        """At most 10 Hz with a change, 1 Hz without."""
        return now_ns - self._progress_ns >= (PROGRESS_NS if changed else HEARTBEAT_NS)

    def progress(self, progress: ResultProgress | None, now_ns: int) -> None:
        """How far the fold is; None repeats the last."""
        self._progress, self._progress_ns = progress or self._progress, now_ns
        self._send(self._progress)

    def preview_due(self, now_ns: int, lag_frames: int) -> bool:
        """The last preview is long enough ago, measured by what it cost and by how far the fold is behind now."""
        behind = lag_frames > BEHIND_FRAMES
        least_ns, rest = (PREVIEW_BEHIND_NS, REST_BEHIND) if behind else (PREVIEW_NS, REST)
        return now_ns >= self._preview_ns + max(least_ns, rest * self._preview_cost_ns)

    def preview_made(self, start_ns: int, end_ns: int) -> None:
        """A preview was made and published in this time."""
        self._preview_ns, self._preview_cost_ns = end_ns, end_ns - start_ns

    def points(
        self, cloud: PointCloud, provisional: NDArray[np.bool_], folded_through: int, *, final: bool = False
    ) -> None:
        """The tiles that changed; ``final``: all of them, each point exact."""
        if self._tiles is None:
            return
        headers, payload = self._tiles.update(cloud, provisional, everything=final)
        if final:
            headers, payload = self._tiles.snapshot()
        if headers or final:
            self._version += 1
            self._folded_through = folded_through
            self._send_tiles(headers, payload, snapshot=final)

    def maps_due(self, now_ns: int) -> bool:
        """About once a second, and only with subscribers."""
        return self._watched and now_ns >= self._maps_ns + MAPS_NS

    def maps(self, samples: MapSamples, folded_through: int, now_ns: int) -> None:
        """The maps so far, or the finished ones."""
        message = ResultMaps(
            scan_uid=self._scan_uid,
            version=0,
            folded_through=folded_through,
            shape=list(samples.minimum.shape),
            step=samples.step,
            contrast=self._contrast,
            bit_depth=self._bit_depth,
        )
        self._maps, self._maps_ns = (message, samples.payload), now_ns
        self._send(*self._maps)

    def results(self, end: ResultEnd) -> None:
        """Maps, cloud and report are on disk."""
        self.end = end
        self._send(end)

    def _send_tiles(self, headers: list[TileHeader], payload: bytes, *, snapshot: bool) -> None:
        message = ResultTiles(
            scan_uid=self._scan_uid,
            version=0,
            folded_through=self._folded_through,
            snapshot=snapshot,
            tiles=headers,
        )
        self._send(message, payload)

    def _send(
        self, message: ResultProgress | ResultTiles | ResultMaps | ResultEnd, payload: bytes | None = None
    ) -> None:
        """Send with the version of the points; what finds a full queue is dropped."""
        self.dropped += not self._sender.send(msgspec.structs.replace(message, version=self._version), payload)
