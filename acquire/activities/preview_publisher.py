"""Publishes the newest camera picture on the preview lane. Lossy by design; without subscribers no work is done."""

from __future__ import annotations

from typing import Any, Final

import zmq

from acquire.contract.messaging.lanes import Sender
from acquire.contract.messaging.messages import FrameFormat, Picture
from acquire.contract.units import NS_PER_S

from .images import PreviewFrame, measure, reduce

MOST_IN_A_SWEEP_HZ: Final = 5.0
"""During a sweep no more pictures are made: they come after the frames."""
_SUBSCRIBED, _LEFT = b"\x01", b"\x00"
_MOST_SUBSCRIPTIONS: Final = 64
"""Read in one turn, so that no client can keep the loop busy with them."""


class PreviewPublisher:
    """XPUB side of the preview lane. One thread calls everything."""

    def __init__(self, socket: zmq.Socket[Any]) -> None:
        self._sender = Sender(socket)
        self.watched = False
        """True while there are subscribers."""
        self._newest: PreviewFrame | None = None
        self._next_ns = 0
        self.counters = {"pictures": 0, "pictures_dropped": 0}

    def poll(self) -> None:
        """Read subscriptions and their ends; anything else on this socket is ignored."""
        for _ in range(_MOST_SUBSCRIPTIONS):
            try:
                message = self._sender.socket.recv_multipart(zmq.NOBLOCK, copy=True)
            except zmq.Again:
                return
            if message in ([_SUBSCRIBED], [_LEFT]):
                self.watched = message == [_SUBSCRIBED]

    def keep(self, frame: PreviewFrame) -> None:
        """Remember a sweep's newest frame; :meth:`flush` may show it. The pixels must not change any more."""
        self._newest = frame if self.watched else None

    def flush(self, now_ns: int, frame_format: FrameFormat, rate_hz: float) -> None:
        """Show the frame that was kept, at most ``rate_hz`` times per second; call it when nothing else waits."""
        if self._newest is None or now_ns < self._next_ns:
            return
        frame, self._newest = self._newest, None
        self._next_ns = now_ns + round(NS_PER_S / min(rate_hz, MOST_IN_A_SWEEP_HZ))
        self.show(frame, frame_format)

    def show(self, frame: PreviewFrame, frame_format: FrameFormat) -> None:
        """Reduce a frame and publish it, if there are subscribers."""
        if not self.watched:
            return
        small = reduce(frame.pixels, frame_format)
        brightness = measure(frame.pixels, frame_format.bit_depth)
        picture = Picture(
            scan_uid=frame.scan_uid,
            shape=list(small.shape),
            source_shape=list(frame.pixels.shape[:2]),
            frame_index=frame.frame_index,
            position_steps=frame.position_steps,
            position_um=frame.position_um,
            exposure_ms=frame.exposure_ms,
            full_scale_share=brightness.full_scale_share,
            low=brightness.low,
            high=brightness.high,
        )
        sent = self._sender.send(picture, small)
        self.counters["pictures" if sent else "pictures_dropped"] += 1
