"""Forwards sockets message by message, and checks commands on the way.

What the rig publishes is forwarded unchanged. A command is parsed and passed to ``judge``, then forwarded or refused;
its reply is routed by the request id. Nothing is queued for a side that is not connected.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import zmq

from acquire.contract.errors import CommandRefusedError, ProtocolError
from acquire.contract.messaging.codec import decode_as, encode
from acquire.contract.messaging.messages import Command, Reply

MAX_BURST = 64
MAX_ASKED = 1024
"""Requests whose replies are still awaited; the oldest are forgotten (their askers have long given up)."""

MAX_TOPIC = 64
"""Bytes of a subscription; ours are empty."""

Socket = zmq.Socket[Any]


@dataclass(frozen=True)
class Ends:
    """The two sockets of one connection."""

    front: Socket
    """Toward whoever connects: XPUB, or ROUTER on the command lane."""
    back: Socket
    """Toward the rig: XSUB, or DEALER on the command lane."""


class Relay:
    """Takes over the sockets that it is given, and closes them. Not thread-safe."""

    def __init__(
        self,
        spoken: Mapping[str, Ends],
        asked: Ends,
        judge: Callable[[Command, str], Command],
        listen: Callable[[str, list[zmq.Frame]], list[Any]] = lambda lane, parts: parts,
    ) -> None:
        """Connect pairs of sockets.

        Args:
            spoken: the lanes on which the rig speaks, by name.
            asked: the command lane.
            judge: (command, who asks) -> the command as it goes on; raises CommandRefusedError with the reason.
                Who asks is the public key of an authenticated peer, else empty.
            listen: is shown every message of the spoken lanes and says how it goes on.
        """
        self._spoken, self._asked = dict(spoken), asked
        self._judge, self._listen = judge, listen
        self._awaited: OrderedDict[str, bytes] = OrderedDict()
        self.malformed = 0
        self._poller = zmq.Poller()
        for ends in (*self._spoken.values(), asked):
            self._poller.register(ends.front, zmq.POLLIN)
            self._poller.register(ends.back, zmq.POLLIN)

    def close(self) -> None:
        """Close all sockets; unsent messages are dropped."""
        for ends in (*self._spoken.values(), self._asked):
            ends.front.close(0)
            ends.back.close(0)

    def turn(self, timeout_ms: int) -> None:
        """Wait for messages for at most ``timeout_ms`` and forward them."""
        ready = dict(self._poller.poll(timeout_ms))
        for lane, ends in self._spoken.items():
            if ends.front in ready:
                _carry_subscriptions(ends.front, ends.back)
            if ends.back in ready:
                self._carry(lane, ends)
        if self._asked.front in ready:
            self._take_commands()
        if self._asked.back in ready:
            self._take_replies()

    def _carry(self, lane: str, ends: Ends) -> None:
        for _ in range(MAX_BURST):
            parts = _next(ends.back)
            if parts is None:
                return
            with suppress(zmq.Again):  # lossy, as the socket is
                ends.front.send_multipart(self._listen(lane, parts), zmq.NOBLOCK, copy=False)

    def _take_commands(self) -> None:
        for _ in range(MAX_BURST):
            parts = _next(self._asked.front)
            if parts is None:
                return
            try:
                command = decode_as(parts[1].buffer if len(parts) == 2 else b"", Command)
            except ProtocolError:
                self.malformed += 1
                continue
            self._pass_on(command, parts[0].bytes, _user_of(parts[1]))

    def _pass_on(self, command: Command, routing_id: bytes, who: str) -> None:
        try:
            command = self._judge(command, who)
            self._asked.back.send(encode(command), zmq.NOBLOCK)
        except CommandRefusedError as error:
            self._answer(routing_id, Reply(request_id=command.request_id, ok=False, error=str(error)))
        except zmq.Again:
            away = "not sent: the rig daemon is not connected"
            self._answer(routing_id, Reply(request_id=command.request_id, ok=False, error=away))
        else:
            self._awaited[command.request_id] = routing_id
            while len(self._awaited) > MAX_ASKED:
                self._awaited.popitem(last=False)

    def _take_replies(self) -> None:
        for _ in range(MAX_BURST):
            parts = _next(self._asked.back)
            if parts is None:
                return
            try:
                reply = decode_as(parts[0].buffer, Reply)
            except ProtocolError:
                self.malformed += 1
                continue
            routing_id = self._awaited.get(reply.request_id)
            if routing_id is not None:
                self._answer(routing_id, reply)

    def _answer(self, routing_id: bytes, reply: Reply) -> None:
        with suppress(zmq.Again, zmq.ZMQError):  # the client has disconnected
            self._asked.front.send_multipart([routing_id, encode(reply)], zmq.NOBLOCK)


def _next(source: Socket) -> list[zmq.Frame] | None:
    try:
        return source.recv_multipart(zmq.NOBLOCK, copy=False)
    except zmq.Again:
        return None


def _carry_subscriptions(source: Socket, target: Socket) -> None:
    """Towards a publishing socket of the rig, forward subscriptions only."""
    for _ in range(MAX_BURST):
        parts = _next(source)
        if parts is None:
            return
        if len(parts) == 1 and 1 <= len(parts[0]) <= MAX_TOPIC and parts[0].bytes[0] <= 1:
            target.send(parts[0].bytes, zmq.NOBLOCK)


def _user_of(frame: zmq.Frame) -> str:
    try:
        return str(frame.get("User-Id"))
    except zmq.ZMQError:
        return ""
