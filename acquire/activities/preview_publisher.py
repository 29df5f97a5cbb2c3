"""Publishes the newest camera picture on the preview lane. Lossy by design; without subscribers no work is done."""

from __future__ import annotations

import time
from typing import Any, Final

import zmq

from acquire.contract.messaging.lanes import Sender
from acquire.contract.messaging.messages import FrameFormat, Picture
from acquire.contract.units import NS_PER_S

from .images import View, measure, reduce

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
        self._newest: View | None = None
        self._next_ns = 0
        self.counters = {"pictures": 0, "pictures_dropped": 0}
        self.spent_ns = 0
        """Time spent on pictures so far, in ns."""

    def poll(self) -> None:
        """Read subscriptions and their ends; anything else on this socket is ignored."""
        for _ in range(_MOST_SUBSCRIPTIONS):
            try:
                message = self._sender.socket.recv_multipart(zmq.NOBLOCK, copy=True)
            except zmq.Again:
                return
            if message in ([_SUBSCRIBED], [_LEFT]):
                self.watched = message == [_SUBSCRIBED]

    def keep(self, view: View) -> None:
        """Remember a sweep's newest frame; :meth:`flush` may show it. The pixels must not change any more."""
        self._newest = view if self.watched else None

    def flush(self, now_ns: int, frame_format: FrameFormat, rate_hz: float) -> None:
        """Show the frame that was kept, at most ``rate_hz`` times per second; call it when nothing else waits."""
        if self._newest is None or now_ns < self._next_ns:
            return
        view, self._newest = self._newest, None
        self._next_ns = now_ns + round(NS_PER_S / min(rate_hz, MOST_IN_A_SWEEP_HZ))
        self.show(view, frame_format)

    def show(self, view: View, frame_format: FrameFormat) -> None:
        """Reduce a frame and publish it, if there are subscribers."""
        if not self.watched:
            return
        begin_ns = time.perf_counter_ns()
        small = reduce(view.pixels, frame_format)
        brightness = measure(view.pixels, frame_format.bit_depth)
        picture = Picture(
            scan_uid=view.scan_uid,
            shape=list(small.shape),
            source_shape=list(view.pixels.shape[:2]),
            frame_index=view.frame_index,
            position_steps=view.position_steps,
            position_um=view.position_um,
            exposure_ms=view.exposure_ms,
            full_scale_share=brightness.full_scale_share,
            low=brightness.low,
            high=brightness.high,
        )
        sent = self._sender.send(picture, small)
        self.counters["pictures" if sent else "pictures_dropped"] += 1
        self.spent_ns += time.perf_counter_ns() - begin_ns
