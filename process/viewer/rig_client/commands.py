"""Owns the viewer's way to the daemon: one thread sends requests in the order of the clicks and collects the replies.

A click is sent at once or not at all: with no daemon at the other end it is refused here, never kept for a daemon
that comes up later, when nobody expects the stage to move.
"""

from __future__ import annotations

import os
import queue
import threading
import uuid
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zmq

from acquire.contract.errors import ProtocolError
from acquire.contract.messaging.lanes import Sender, open_socket, receive
from acquire.contract.messaging.messages import Command, Reply
from acquire.contract.process.clocks import Clock, MonotonicClock
from acquire.contract.process.run_dir import endpoint
from acquire.contract.units import NS_PER_S

QUEUE_LENGTH = 16
STALE_NS = 500_000_000
"""A click that waited longer (this process was frozen) is not sent, unless it is a stop."""
BEAT_STALE_NS = 250_000_000
"""Beats bunch up on a jittery tunnel; a late one must not move the stage on."""
CONNECTING_NS = 300_000_000
"""A click is tried again for so long: the lanes of a daemon that has just started connect one after the other."""
POLL_MS = 200
RETRY_MS = 20
JOIN_TIMEOUT_S = 5.0
RECONNECT_MS = 100


@dataclass(frozen=True)
class Note:
    """What became of the last click, for people."""

    text: str = ""
    ok: bool = True
    at_ns: int = 0


@dataclass(frozen=True)
class _Click:
    name: str
    args: dict[str, Any]
    at_ns: int
    client: str = ""

    @property
    def beat(self) -> bool:
        """One of many that follow each other: nothing is said of it unless it is refused, and a late one is dropped."""
        return self.name == "jog_hold" or self.args.get("action") == "renew"


@dataclass(frozen=True)
class _Pending:
    name: str
    deadline_ns: int
    beat: bool = False


@dataclass
class CommandLine:
    """Sends commands from a thread of its own; :meth:`submit` never blocks and is safe from any thread."""

    run_dir: Path
    timeout_s: float
    """How long a reply is waited for (limits.command_s)."""
    on_note: Callable[[], None] = lambda: None
    """Called from the thread when there is a new note."""
    clock: Clock = field(default_factory=MonotonicClock)

    def __post_init__(self) -> None:
        self._queue: queue.Queue[_Click] = queue.Queue(QUEUE_LENGTH)
        self._pending: dict[str, _Pending] = {}
        self._note = Note()
        self._closing = False
        self.beats_dropped = 0
        """Beats that came too late and were not sent."""
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_write, False)
        self._thread = threading.Thread(target=self._run, name="viewer-commands")

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def close(self) -> None:
        """End the thread and close its socket; requests without a reply are given up."""
        self._closing = True
        self._wake()
        self._thread.join(JOIN_TIMEOUT_S)
        os.close(self._wake_write)
        os.close(self._wake_read)

    @property
    def note(self) -> Note:
        """What became of the last click."""
        return self._note

    def submit(self, name: str, args: dict[str, Any] | None = None, *, client: str = "") -> bool:
        """Queue one request in the name of ``client``; False (with a note) if the queue is full."""
        try:
            self._queue.put_nowait(_Click(name, args or {}, self.clock.now_ns(), client))
        except queue.Full:
            self._say(f"{name} was not sent: too many requests are waiting; try again", ok=False)
            return False
        self._wake()
        return True

    def _wake(self) -> None:
        try:
            os.write(self._wake_write, b"x")
        except BlockingIOError:
            return  # the pipe is full of wake-ups already

    def _say(self, text: str, *, ok: bool) -> None:
        self._note = Note(text, ok, self.clock.now_ns())
        self.on_note()

    def _run(self) -> None:
        context: zmq.Context[Any] = zmq.Context()
        socket = open_socket(context, zmq.DEALER, "command")
        try:
            socket.setsockopt(zmq.IMMEDIATE, 1)  # queue only for a daemon that is there
            socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
            socket.connect(endpoint(self.run_dir, "command"))
            self._talk(socket)
        finally:
            socket.close(0)
            context.term()

    def _talk(self, socket: Any) -> None:
        poller = zmq.Poller()
        poller.register(self._wake_read, zmq.POLLIN)
        poller.register(socket, zmq.POLLIN)
        sender = Sender(socket)
        clicks: deque[_Click] = deque()
        while not self._closing:
            ready = dict(poller.poll(RETRY_MS if clicks else POLL_MS))
            if self._wake_read in ready:
                os.read(self._wake_read, 4096)
            while not self._queue.empty():
                clicks.append(self._queue.get_nowait())
            while clicks and self._settled(clicks[0], sender):
                clicks.popleft()
            if socket in ready:
                self._take_reply(socket)
            self._give_up_overdue()

    def _settled(self, click: _Click, sender: Sender) -> bool:
        """Send one click; False if it should be tried again, because a daemon may be just connecting."""
        if click.name != "stop" and not click.beat and self._on_its_way(click.name):
            return True
        now_ns = self.clock.now_ns()
        too_old = now_ns - click.at_ns > (BEAT_STALE_NS if click.beat else STALE_NS)
        request_id = uuid.uuid4().hex
        if too_old and click.beat:
            self.beats_dropped += 1
            return True
        if too_old and click.name != "stop":
            self._say(f"{click.name} was not sent in time; nothing has moved", ok=False)
            return True
        command = Command(request_id=request_id, name=click.name, args=click.args, client=click.client)
        if sender.send(command):
            self._pending[request_id] = _Pending(click.name, now_ns + round(self.timeout_s * NS_PER_S), click.beat)
            if not click.beat:
                self._say(f"{click.name} ...", ok=True)
            return True
        if now_ns - click.at_ns > CONNECTING_NS:
            self._say(f"{click.name} was not sent: no rig daemon answers; start it with 'sweepscope up'", ok=False)
            return True
        return False

    def _on_its_way(self, name: str) -> bool:
        """A second click while the first waits for its reply is no new request."""
        return any(waiting.name == name and not waiting.beat for waiting in self._pending.values())

    def _take_reply(self, socket: Any) -> None:
        try:
            received = receive(socket)
        except ProtocolError:
            return  # its request runs into its time-out, which is said
        if received is None or not isinstance(received.message, Reply):
            return
        waiting = self._pending.pop(received.message.request_id, None)
        if waiting is None:
            return
        if received.message.ok and waiting.beat:
            return
        if received.message.ok:
            self._say(f"{waiting.name}: done", ok=True)
        else:
            self._say(f"{waiting.name} was refused: {received.message.error}", ok=False)

    def _give_up_overdue(self) -> None:
        now_ns = self.clock.now_ns()
        overdue = {request_id for request_id, waiting in self._pending.items() if waiting.deadline_ns < now_ns}
        for request_id in overdue:
            name = self._pending.pop(request_id).name
            self._say(f"{name}: no answer within {self.timeout_s:g} s; look at the state of the rig", ok=False)
