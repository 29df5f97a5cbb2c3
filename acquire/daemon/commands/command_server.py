"""The daemon's end of the command lane: one reply to each request; a repeated request is done once, a late one not."""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, Final

import zmq

from acquire.activities.jog_hold import LEASE_MS
from acquire.contract.errors import ProtocolError, SweepscopeError
from acquire.contract.messaging.lanes import Received, Sender, arrived
from acquire.contract.messaging.messages import Command, Reply
from acquire.contract.permissions import never_late
from acquire.contract.process.clocks import Clock
from acquire.contract.process.log_throttle import log_throttled
from acquire.contract.units import NS_PER_MS, NS_PER_S

logger = logging.getLogger(__name__)
MOST_PER_TURN: Final = 32
MOST_REMEMBERED: Final = 256


class CommandServer:
    """ROUTER side. One thread calls everything."""

    def __init__(
        self, socket: zmq.Socket[Any], clock: Clock, late_after_s: float, do: Callable[[Command, int], dict[str, Any]]
    ) -> None:
        """``do`` does a command at a time (ns) and returns the result of its reply, or raises SweepscopeError."""
        self.socket = socket
        self.malformed = 0
        self._sender = Sender(socket)
        self._clock, self._late_after_ns, self._do = clock, round(late_after_s * NS_PER_S), do
        self._replies: OrderedDict[str, Reply] = OrderedDict()

    def serve(self) -> bool:
        """Answer the requests that have come, up to ``MOST_PER_TURN``; True if there were any."""
        before, answered = self.malformed, 0
        for received in arrived(self.socket, MOST_PER_TURN, self._unreadable):
            self._answer(received)
            answered += 1
        return answered > 0 or self.malformed > before

    def _unreadable(self, error: ProtocolError) -> None:
        self.malformed += 1
        log_throttled(logger, self.malformed, f"command lane: {error}")

    def _answer(self, received: Received) -> None:
        command = received.message
        if not isinstance(command, Command):
            self.malformed += 1
            return
        reply = self._replies.get(command.request_id)
        if reply is None:
            reply = self._reply_to(command)
            self._replies[command.request_id] = reply
            while len(self._replies) > MOST_REMEMBERED:
                self._replies.popitem(last=False)
        self._sender.send(reply, routing_id=received.routing_id)

    def _reply_to(self, command: Command) -> Reply:
        request_id = command.request_id
        now_ns = self._clock.now_ns()
        age_ns = now_ns - command.sent_mono_ns if command.sent_mono_ns else 0
        if age_ns > self._longest_age_ns(command.name):
            # it waited in a queue while the daemon was away or the network stalled: the client has given up
            late = f"{command.name} came {age_ns / NS_PER_S:.1f} s late and was not done; ask again"
            return Reply(request_id=request_id, ok=False, error=late)
        try:
            return Reply(request_id=request_id, ok=True, result=self._do(command, now_ns))
        except SweepscopeError as error:
            return Reply(request_id=request_id, ok=False, error=str(error))
        except OSError as error:
            # a failing disk must not end the daemon, and with it a running sweep
            logger.exception("%s failed", command.name)
            return Reply(request_id=request_id, ok=False, error=f"{command.name} failed: {error}")

    def _longest_age_ns(self, name: str) -> float:
        if never_late(name):
            return float("inf")
        # repeated key presses that queued up on the way must not move the stage after the key was released
        return LEASE_MS * NS_PER_MS if name == "jog_hold" else self._late_after_ns
