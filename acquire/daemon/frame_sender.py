"""The daemon's end of the frames lane: keeps each frame until its ack, and sends it again to a new writer."""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import dataclass
from typing import Any

import zmq

from acquire.contract.errors import ProtocolError
from acquire.contract.frame_ranges import indices_of
from acquire.contract.messaging.lanes import Received, Sender, arrived
from acquire.contract.messaging.messages import Ack, AckItem, End, EndAck, Hello, Image, Message, Nack, Start, StartAck
from acquire.contract.process.log_throttle import log_throttled
from acquire.contract.units import NS_PER_S
from acquire.sweep.credit_window import FrameKey
from acquire.sweep.events import Committed, LaneEvent, Refused, Sealed, WriterReady

logger = logging.getLogger(__name__)
RETRY_NS = 1 * NS_PER_S
COUNTERS = ("sent", "resent", "malformed", "superseded", "unsent", "nacks", "stray_acks")
MAX_BURST = 256
"""Messages handled in one call, so that the caller's loop stays responsive."""


@dataclass(frozen=True)
class Unacked:
    """A frame that the writer has not acknowledged; its pixels must not change until it has."""

    image: Image
    pixels: Any


@dataclass
class _Writer:
    routing_id: bytes
    epoch: str
    acknowledged: bool = False
    """It has sent start_ack for the scan that runs."""
    announced: bool = False
    """``start`` was sent to it, and it has not said hello since."""


class FrameSender:
    """ROUTER side of the frames lane. Not thread-safe: one thread calls everything."""

    def __init__(self, socket: zmq.Socket[Any]) -> None:
        self.socket = socket
        self.sender = Sender(socket)
        self.unacked: dict[FrameKey, Unacked] = {}
        self.last_heard_ns = 0
        self.counters = dict.fromkeys(COUNTERS, 0)
        self._writer: _Writer | None = None
        self._superseded: deque[str] = deque(maxlen=1000)
        self._start: Start | None = None
        self._end: End | None = None
        self._retry_at_ns = 0
        self._had_writer = False
        self._acked: set[int] = set()
        """Indices of the sweep frames that the writer holds."""

    def begin(self, start: Start) -> None:
        """Announce a scan; ``WriterReady`` follows once a writer has made its file."""
        self.forget()
        self._start, self._had_writer = start, False
        if self._writer is not None:
            self._writer.acknowledged = self._writer.announced = False
            self._greet()

    def forget(self) -> None:
        """The scan is over: drop the frames that are still kept."""
        self._start = self._end = None
        self.unacked, self._acked = {}, set()

    @property
    def ready(self) -> bool:
        """A writer has acknowledged the running scan."""
        return self._writer is not None and self._writer.acknowledged

    def alive(self, now_ns: int, lost_after_ns: int) -> bool:
        """True if a message of the writer came within ``lost_after_ns``."""
        return self._writer is not None and now_ns - self.last_heard_ns <= lost_after_ns

    def offer(self, image: Image, pixels: Any) -> None:
        """Keep a frame and send it to the writer, now or when there is one."""
        if image.role == "sweep" and image.frame_index in self._acked:
            return
        frame = self.unacked[image.role, image.frame_index] = Unacked(image, pixels)
        if self.ready:
            self._send_frame(frame)

    def finish(self, end: End) -> None:
        """No more frames follow; sent now, and again to a writer that comes back. ``Sealed`` follows."""
        self._end = end
        if self.ready:
            self._send(end)

    def poll(self, now_ns: int) -> list[LaneEvent]:
        """Handle the writer's messages; returns them as events of the sweep.

        A second after a refusal that may pass (no space, I/O error, damaged on the way, busy) all unacknowledged frames
        are sent again.
        """
        events: list[LaneEvent] = []
        for received in arrived(self.socket, MAX_BURST, self._unreadable):
            event = self._take(received, now_ns)
            if event is not None:
                events.append(event)
        if self._retry_at_ns and now_ns >= self._retry_at_ns:
            self._retry_at_ns = 0
            self._replay()
        return events

    def _unreadable(self, error: ProtocolError) -> None:
        self.counters["malformed"] += 1
        log_throttled(logger, self.counters["malformed"], f"frames lane: {error}")

    def _take(self, received: Received, now_ns: int) -> LaneEvent | None:
        message, routing_id = received.message, received.routing_id or b""
        if not isinstance(message, (Hello, StartAck, Ack, EndAck, Nack)):
            self.counters["malformed"] += 1
            return None
        if not self._accept(message, routing_id):
            return None
        self.last_heard_ns = now_ns
        if isinstance(message, Hello):
            self._greet()
            assert self._writer is not None
            self._writer.announced = False
            return None
        if self._start is None or message.scan_uid != self._start.scan_uid:
            return None
        return self._event_of(message, now_ns)

    def _event_of(self, message: StartAck | Ack | EndAck | Nack, now_ns: int) -> LaneEvent:
        if isinstance(message, StartAck):
            return self._take_start_ack(message)
        if isinstance(message, Ack):
            return self._take_ack(message)
        if isinstance(message, Nack):
            return self._take_nack(message, now_ns)
        return Sealed(message)

    def _accept(self, message: Message, routing_id: bytes) -> bool:
        """Adopt a new writer; refuse one that was superseded."""
        if message.epoch in self._superseded:
            self.counters["superseded"] += 1
            nack = Nack(reason="superseded", scan_uid=message.scan_uid)
            self.sender.send(nack, routing_id=routing_id)
            return False
        if self._writer is None or self._writer.epoch != message.epoch:
            if not isinstance(message, Hello):
                # only a hello makes a writer: a stray ack must never turn the real one away
                self.counters["malformed"] += 1
                return False
            if self._writer is not None:
                self._superseded.append(self._writer.epoch)
            self._writer = _Writer(routing_id, message.epoch)
        elif self._writer.routing_id != routing_id:
            # it reconnected: what was on the way is lost, so the scan is announced and replayed again
            self._writer = _Writer(routing_id, message.epoch)
            self._greet()
        return True

    def _greet(self) -> None:
        """Announce the scan to a writer that has not acknowledged it; once for each hello."""
        writer = self._writer
        if self._start is None or writer is None or writer.acknowledged or writer.announced:
            return
        writer.announced = True
        self._send(self._start)

    def _take_start_ack(self, message: StartAck) -> LaneEvent:
        assert self._writer is not None
        known, self._writer.acknowledged = self._writer.acknowledged, True
        came_back, self._had_writer = self._had_writer, True
        committed = zip(indices_of(message.committed), message.crc32, strict=False)
        items = tuple(AckItem(frame_index, 0, crc32) for frame_index, crc32 in committed)
        for item in items:
            self._settle(item)
        if not known:
            self._replay()
        return WriterReady(message.reserved, came_back, items)

    def _take_ack(self, message: Ack) -> LaneEvent:
        return Committed(tuple(item for item in message.frames if self._was_sent(item)), message.durable_count)

    def _was_sent(self, item: AckItem) -> bool:
        """Only a frame that was sent can be acked; ``start_ack`` names the others that are in the file."""
        if (item.role, item.frame_index) in self.unacked:
            self._settle(item)
            return True
        self.counters["stray_acks"] += item.role == "sweep" and item.frame_index not in self._acked
        return False

    def _settle(self, item: AckItem) -> None:
        """A frame is committed; one that the file holds with other pixels stays unacknowledged."""
        key = (item.role, item.frame_index)
        if key in self.unacked and self.unacked[key].image.crc32 != item.crc32:
            return
        self.unacked.pop(key, None)
        if item.role == "sweep":
            self._acked.add(item.frame_index)

    def _take_nack(self, message: Nack, now_ns: int) -> LaneEvent:
        self.counters["nacks"] += 1
        event = Refused(message)
        if message.reason in ("no space", "io error", "crc", "shape", "busy"):
            self._retry_at_ns = now_ns + RETRY_NS
        elif event.is_final:
            # sending it again would change nothing; the end will name it as missing
            self.unacked.pop((message.role, message.frame_index), None)
        elif message.reason == "no such scan" and self._writer is not None:
            self._writer.acknowledged = False
            self._greet()
        return event

    def _replay(self) -> None:
        for frame in sorted(self.unacked.values(), key=lambda frame: frame.image.frame_index):
            self.counters["resent"] += 1
            self._send_frame(frame)
        if self._end is not None:
            self._send(self._end)

    def _send_frame(self, frame: Unacked) -> None:
        self._send(frame.image, frame.pixels)
        self.counters["sent"] += 1

    def _send(self, message: Message, payload: Any = None) -> None:
        assert self._writer is not None
        if not self.sender.send(message, payload, routing_id=self._writer.routing_id):
            # the writer is gone: whoever comes next says hello and gets everything again
            self.counters["unsent"] += 1
