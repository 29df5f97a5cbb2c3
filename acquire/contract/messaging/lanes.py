"""The lanes: sockets with their bounds set, and sending and receiving of typed messages over them."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import zmq

from acquire.contract.errors import ConfigError, ProtocolError
from acquire.contract.process.clocks import mono_ns
from acquire.contract.process.run_dir import endpoint

from .codec import decode, encode
from .messages import MAX_FRAME_BYTES, Message

MAX_COMMAND_BYTES = 1024 * 1024
_MAX_BYTES = {
    "frames": MAX_FRAME_BYTES,
    "live": MAX_FRAME_BYTES,
    "results": MAX_FRAME_BYTES,
    "status": MAX_COMMAND_BYTES,
    "command": MAX_COMMAND_BYTES,
    "preview": MAX_FRAME_BYTES,
}
LIVE_MARK = 16
"""Frames that may wait for a subscriber of the live lane; they are the daemon's memory."""
_MARKS = {"frames": 100_000, "live": LIVE_MARK, "results": 64, "status": 16, "command": 256, "preview": 2}
"""High-water marks in messages; that of the frames lane lies far above any window and never decides."""
RECONNECT_MS = 50
RECONNECT_MAX_MS = 500
"""First and longest wait before a socket tries again to reach a service that is away."""


def open_socket(context: zmq.Context[Any], kind: int, lane: str) -> zmq.Socket[Any]:
    """An unconnected socket with the lane's bounds; LINGER 0 so that no process hangs on its way out."""
    socket: zmq.Socket[Any] = context.socket(kind)
    socket.setsockopt(zmq.LINGER, 0)
    if kind in (zmq.SUB, zmq.XSUB, zmq.DEALER):
        socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
        socket.setsockopt(zmq.RECONNECT_IVL_MAX, RECONNECT_MAX_MS)
    socket.setsockopt(zmq.MAXMSGSIZE, _MAX_BYTES[lane])
    socket.setsockopt(zmq.SNDHWM, _MARKS[lane])
    socket.setsockopt(zmq.RCVHWM, _MARKS[lane])
    if kind == zmq.ROUTER:
        socket.setsockopt(zmq.ROUTER_MANDATORY, 1)
    return socket


def bind(context: zmq.Context[Any], kind: int, run_dir: Path, lane: str) -> zmq.Socket[Any]:
    """A socket bound to the lane's endpoint; take the service's lock before (a second bind steals an ipc path).

    Raises:
        ConfigError: it cannot be created there.
    """
    socket = open_socket(context, kind, lane)
    try:
        socket.bind(endpoint(run_dir, lane))
    except zmq.ZMQError as error:
        raise ConfigError(f"cannot create {lane}.sock in {run_dir}: {error.strerror}; set SWEEPSCOPE_RUN") from None
    return socket


def connect(
    context: zmq.Context[Any],
    kind: int,
    run_dir: Path,
    lane: str,
    *,
    immediate: bool = False,
    queued: int | None = None,
) -> zmq.Socket[Any]:
    """A socket connected to the lane's endpoint (which may not exist yet); SUB sockets subscribe to all.

    ``immediate``: nothing is queued for a peer that is not there; sending fails instead. ``queued``: messages that
    may wait to be received, None as many as the lane has it.
    """
    socket = open_socket(context, kind, lane)
    if queued is not None:
        socket.setsockopt(zmq.RCVHWM, queued)
    if kind == zmq.SUB:
        socket.setsockopt(zmq.SUBSCRIBE, b"")
    socket.setsockopt(zmq.IMMEDIATE, immediate)
    socket.connect(endpoint(run_dir, lane))
    return socket


def shared(pixels: Any) -> zmq.Frame:
    """Pixels as one part for messages on several lanes, not copied (but small ones), so they must not change any more.

    Otherwise each socket would wrap them anew, and a thread of pyzmq would release each of these parts.
    """
    return zmq.Frame(pixels)


@dataclass
class Sender:
    """Stamps sequence, epoch and time onto messages of one lane and sends them."""

    socket: zmq.Socket[Any]
    epoch: str = field(default_factory=lambda: uuid.uuid4().hex)
    seq: int = 0

    def stamp(self, message: Message, sent_mono_ns: int | None = None) -> Message:
        """The message with the next sequence number, this sender's boot id and the monotonic time (now, if None)."""
        self.seq += 1
        when_ns = mono_ns() if sent_mono_ns is None else sent_mono_ns
        return msgspec.structs.replace(message, seq=self.seq, epoch=self.epoch, sent_mono_ns=when_ns)

    def send(
        self,
        message: Message,
        payload: Any = None,
        *,
        routing_id: bytes | None = None,
        sent_mono_ns: int | None = None,
    ) -> bool:
        """Send without blocking; the payload is not copied and must not change until its ack.

        ``sent_mono_ns``: of the first sending, where this is a second one, so that its age stays known.

        Returns:
            False if the peer is gone or its queue is full: the caller counts it.
        """
        parts: list[Any] = [encode(self.stamp(message, sent_mono_ns))]
        if payload is not None:
            parts.append(payload)
        if routing_id is not None:
            parts.insert(0, routing_id)
        try:
            self.socket.send_multipart(parts, flags=zmq.NOBLOCK, copy=payload is None)
        except (zmq.Again, zmq.ZMQError) as error:
            if error.errno in (zmq.EAGAIN, zmq.EHOSTUNREACH):
                return False
            raise
        return True


@dataclass(frozen=True)
class Received:
    """One message with what came along with it."""

    message: Message
    payload: zmq.Frame | None = None
    routing_id: bytes | None = None

    @property
    def buffer(self) -> bytes | memoryview:
        """The payload, not copied; empty if there is none."""
        return self.payload.buffer if self.payload is not None else b""


def receive(socket: zmq.Socket[Any]) -> Received | None:
    """The next message, None if there is none now.

    Raises:
        ProtocolError: the parts do not form a message; it is consumed, count it and go on.
    """
    try:
        parts = socket.recv_multipart(flags=zmq.NOBLOCK, copy=False)
    except zmq.Again:
        return None
    return _assemble(parts, routed=socket.type == zmq.ROUTER)


def arrived(
    socket: zmq.Socket[Any], most: int, on_malformed: Callable[[ProtocolError], Any] = lambda _error: None
) -> Iterator[Received]:
    """The messages that are there now, up to ``most``; malformed ones are passed to ``on_malformed`` instead."""
    for _ in range(most):
        try:
            received = receive(socket)
        except ProtocolError as error:
            on_malformed(error)
            continue
        if received is None:
            return
        yield received


def _assemble(parts: Sequence[zmq.Frame], *, routed: bool) -> Received:
    routing_id = parts[0].bytes if routed else None
    body = parts[1:] if routed else parts
    if not 1 <= len(body) <= 2:
        raise ProtocolError(f"a message of {len(body)} parts")
    message = decode(body[0].buffer)
    return Received(message, body[1] if len(body) == 2 else None, routing_id)
