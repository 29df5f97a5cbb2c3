"""Owns what the worker says on the results lane: progress, tiles, maps, the end, and all of it to a newcomer."""

from __future__ import annotations

import logging
import time
from typing import Any

import msgspec
import zmq

from acquire.contract.errors import SweepscopeError
from acquire.contract.messaging.lanes import Sender
from acquire.contract.messaging.messages import ResultEnd, ResultMaps, ResultProgress, ResultTiles
from acquire.contract.units import NS_PER_MS

from . import live_maps
from .live_tiles import LiveTiles
from .provisional_cloud import Preview
from .session import ScanSession

logger = logging.getLogger(__name__)

PROGRESS_NS = 100 * NS_PER_MS
HEARTBEAT_NS = 1000 * NS_PER_MS
PREVIEW_LEAST_NS = 250 * NS_PER_MS
REST = 3
"""Previews rest for so many times what the last one cost: at most a quarter of the time goes into them ..."""
REST_BEHIND, BEHIND_FRAMES = 15, 32
"""... and a sixteenth where the fold is so many frames behind: it comes first ..."""
PREVIEW_BEHIND_NS = 1000 * NS_PER_MS
"""... and one look each second is enough to see that it goes on."""
_SUBSCRIBED, _UNSUBSCRIBED = b"\x01", b"\x00"


class Outbox:
    """The worker's XPUB socket. Not thread-safe."""

    def __init__(self, socket: zmq.Socket[Any]) -> None:
        """``socket`` is bound; every subscription is reported, not only the first."""
        socket.setsockopt(zmq.XPUB_VERBOSE, 1)
        self.socket = socket
        self._sender = Sender(socket)
        self._tiles: LiveTiles | None = None
        self._end: ResultEnd | None = None
        self._progress = ResultProgress(version=0, folded_through=-1, expected=0, message="no scan yet")
        self._progress_ns = 0
        self._looked_ns = self._look_cost_ns = 0
        """When the last preview was ready, and what it cost."""
        self._version = 0
        self.wants_preview = False
        """Somebody came who has not seen the maps; they do not wait for the next frame."""
        self._maps_ns = 0
        self._watched = False
        self.dropped = 0
        """Messages that found a full queue."""

    def begin(self, session: ScanSession) -> None:
        """A new scan: what was shown before is forgotten."""
        self._tiles = LiveTiles(session.form.width, session.form.height)
        self._end = None
        self._looked_ns = self._look_cost_ns = self._maps_ns = 0
        self._send_tiles(session, *self._tiles.snapshot(), snapshot=True)
        self.say_progress(session, now_ns=0)

    def refuse(self, scan_uid: str, why: str) -> None:
        """A scan that cannot be folded; said again with every heartbeat."""
        self._tiles, self._end = None, None
        self._progress = ResultProgress(scan_uid=scan_uid, version=0, folded_through=-1, expected=0, message=why)
        self._progress_ns = 0

    def answer_newcomers(self, session: ScanSession | None) -> None:
        """Send everything to all when somebody has subscribed (anew: that is how a gap is healed)."""
        asked = False
        while True:
            try:
                word = self.socket.recv(zmq.NOBLOCK)[:1]
            except zmq.Again:
                break
            asked |= word == _SUBSCRIBED
            self._watched = word != _UNSUBSCRIBED  # said when the last one leaves
        if not asked:
            return
        self.say_progress(session, time.monotonic_ns())
        if session is not None and self._tiles is not None:
            self._send_tiles(session, *self._tiles.snapshot(), snapshot=True)
            self._maps_ns, self.wants_preview = 0, True
            self.say_maps_on_disk(session)
        if self._end is not None:
            self._send(self._end)

    def progress_due(self, now_ns: int, *, news: bool) -> bool:
        """At most 10 Hz with news, 1 Hz without."""
        return now_ns - self._progress_ns >= (PROGRESS_NS if news else HEARTBEAT_NS)

    def say_progress(self, session: ScanSession | None, now_ns: int) -> None:
        """How far the fold is."""
        if session is not None:
            self._progress = session.progress(self._version)
        self._progress_ns = now_ns
        self._send(self._progress)

    def preview_due(self, now_ns: int, lag_frames: int) -> bool:
        """The last preview is long enough ago, measured by what it cost and by how far the fold is behind now."""
        behind = lag_frames > BEHIND_FRAMES
        least_ns, rest = (PREVIEW_BEHIND_NS, REST_BEHIND) if behind else (PREVIEW_LEAST_NS, REST)
        return now_ns >= self._looked_ns + max(least_ns, rest * self._look_cost_ns)

    def say_preview(self, session: ScanSession) -> None:
        """The tiles that changed; the next preview waits in proportion to the cost of this one."""
        start_ns = time.monotonic_ns()
        self.wants_preview = False
        preview = session.preview()
        if preview is not None and preview.cloud is not None:
            self._say_points(session, preview, final=False)
        if preview is not None and preview.maps is not None and self._watched and start_ns >= self._maps_ns:
            self._maps_ns = start_ns + live_maps.PERIOD_NS
            self._say_maps(live_maps.sampled(session, preview.maps))
        end_ns = time.monotonic_ns()
        self._looked_ns, self._look_cost_ns = end_ns, end_ns - start_ns

    def say_final(self, session: ScanSession, preview: Preview) -> None:
        """The exact points, all of them, none provisional."""
        self._say_points(session, preview, final=True)

    def say_maps_on_disk(self, session: ScanSession) -> None:
        """The finished maps, if anybody is there to see them."""
        if session.results is None or not self._watched:
            return
        try:
            self._say_maps(live_maps.on_disk(session, session.results.paths.maps))
        except SweepscopeError as error:
            logger.warning("%s", error)  # somebody took them away again; the lane owes nobody a picture

    def _say_maps(self, news: live_maps.MapsNews) -> None:
        self._send(msgspec.structs.replace(news[0], version=self._version), news[1])

    def say_end(self, end: ResultEnd) -> None:
        """Maps and cloud are on disk."""
        self._end = msgspec.structs.replace(end, version=self._version)
        self._send(self._end)

    def _say_points(self, session: ScanSession, preview: Preview, *, final: bool) -> None:
        if self._tiles is None or preview.cloud is None:
            return
        headers, payload = self._tiles.update(preview.cloud, preview.provisional, everything=final)
        if final:
            headers, payload = self._tiles.snapshot()
        if headers or final:
            self._version += 1
            self._send_tiles(session, headers, payload, snapshot=final)

    def _send_tiles(self, session: ScanSession, headers: list[Any], payload: bytes, *, snapshot: bool) -> None:
        message = ResultTiles(
            scan_uid=session.announced.scan_uid,
            version=self._version,
            folded_through=session.cursor.fold.folded_through,
            snapshot=snapshot,
            tiles=headers,
        )
        self._send(message, payload)

    def _send(
        self, message: ResultProgress | ResultTiles | ResultMaps | ResultEnd, payload: bytes | None = None
    ) -> None:
        self.dropped += not self._sender.send(message, payload)
