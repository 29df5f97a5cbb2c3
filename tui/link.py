"""The console's one input thread: owns its sockets, survives any absence of the daemon, and never blocks the screen."""

from __future__ import annotations

import os
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zmq
from textual.message import Message as UiMessage

from acquire.contract.errors import NoServiceError, ProtocolError, SweepscopeError
from acquire.contract.lanes import Received, Sender, connect, open_socket, receive
from acquire.contract.messages import (
    Command,
    Message,
    Picture,
    Reply,
    ResultEnd,
    ResultMaps,
    ResultProgress,
    Status,
)
from acquire.contract.places import client_run_dir, endpoint
from tui.client import new_request
from tui.messages import (
    CommandAnswered,
    LinkChanged,
    MapsArrived,
    News,
    PageKnown,
    PictureArrived,
    ProgressArrived,
    ResultsOnDisk,
    StatusArrived,
)
from tui.up import read_url
from tui.view import MapsView, PictureView

AWAY_S = 1.5
"""No status for so long means that the daemon is away (it sends five per second)."""
PAINT_S = 0.1
"""The screen is told at most so often; what came between is passed over for the newest. A new state is told at once."""
MAX_TOLD = 1000
"""Lines of news that are kept while the screen takes none; older ones go."""
LOOK_S = 1.0
"""How often directories and the page's address are looked at."""
POLL_MS = 100


@dataclass
class _Pending:
    command: Command
    resend_at_s: float
    give_up_at_s: float
    resent: bool = False


class RigLink:
    """Feeds a screen with the rig's state and carries its commands; everything else happens in its thread."""

    def __init__(
        self,
        post: Callable[[UiMessage], Any],
        *,
        run_dir: Path | None = None,
        command_timeout_s: float = 5.0,
        client: str = "",
    ) -> None:
        """``post`` must be safe to call from any thread; ``run_dir`` None looks in the usual places again and again;
        ``client`` is this console's name on the rig.
        """
        self._post = post
        self._client = client
        self._run_dir = run_dir
        self._command_timeout_s = command_timeout_s
        self._outbox: queue.SimpleQueue[Command] = queue.SimpleQueue()
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="rig-link", daemon=True)
        self._pending: dict[str, _Pending] = {}
        self._newest: dict[str, UiMessage] = {}
        self._told: deque[UiMessage] = deque(maxlen=MAX_TOLD)
        self._unseen = threading.Event()
        self._state: tuple[str, str] = ("", "")
        self._urgent = False
        self._pictures_wanted = threading.Event()
        self._heard_at_s: float | None = None
        self._connected: bool | None = None
        self._painted_at_s = 0.0
        self._looked_at_s = float("-inf")
        self._url = ""

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    def close(self, deadline_s: float = 2.0) -> None:
        """End the thread and its sockets."""
        self._ending.set()
        os.eventfd_write(self._wake, 1)
        self._thread.join(deadline_s)
        if not self._thread.is_alive():
            os.close(self._wake)

    def send(self, name: str, /, **args: Any) -> str:
        """Send a command; its fate arrives as :class:`CommandAnswered`. Safe from any thread, never blocks."""
        command = new_request(name, args, self._client)
        self._outbox.put(command)
        os.eventfd_write(self._wake, 1)
        return command.request_id

    def want_pictures(self, wanted: bool) -> None:
        """Listen to camera pictures, or no longer. Safe from any thread."""
        if wanted:
            self._pictures_wanted.set()
        else:
            self._pictures_wanted.clear()

    # ---- everything below runs in the thread ----

    def _run(self) -> None:
        while not self._ending.is_set():
            run_dir = self._find()
            if run_dir is not None:
                self._listen(run_dir)
            else:
                self._refuse_outbox()
                self._ending.wait(LOOK_S)

    def _find(self) -> Path | None:
        if self._run_dir is not None:
            return self._run_dir
        try:
            return client_run_dir()
        except NoServiceError as error:
            self._set_connected(False, str(error))
            return None

    def _listen(self, run_dir: Path) -> None:
        context: zmq.Context[Any] = zmq.Context()
        try:
            sockets = _Sockets(context, run_dir)
        except SweepscopeError as error:
            context.destroy(linger=0)
            self._set_connected(False, str(error))
            self._ending.wait(LOOK_S)
            return
        self._heard_at_s = None
        listening_since_s = time.monotonic()
        try:
            while not self._ending.is_set():
                self._turn(sockets)
                self._look(run_dir)
                away = self._judge_link(run_dir, listening_since_s)
                if away and self._run_dir is None and self._moved(run_dir):
                    return
        finally:
            context.destroy(linger=0)

    def _turn(self, sockets: _Sockets) -> None:
        ready = dict(sockets.poll(self._wake))
        if self._wake in ready:
            with suppress(BlockingIOError):
                os.eventfd_read(self._wake)
        sockets.listen_to_pictures(self._pictures_wanted.is_set())
        for socket in (sockets.command, sockets.status, sockets.results, sockets.preview):
            if socket in ready:
                self._take_all(_drain(socket))
        self._send_outbox(sockets)
        self._chase(sockets)
        self._paint()

    def _take_all(self, waiting: list[Received]) -> None:
        pictures = [received for received in waiting if isinstance(received.message, Picture)]
        maps = [received for received in waiting if isinstance(received.message, ResultMaps)]
        for received in waiting:
            self._take(received.message)
        with suppress(ProtocolError):
            if pictures and pictures[-1].payload is not None:
                self._newest["picture"] = PictureArrived(_picture(pictures[-1]))
            if maps and maps[-1].payload is not None:
                self._newest["maps"] = MapsArrived(_maps(maps[-1]))

    def _take(self, message: Message) -> None:
        if isinstance(message, Status):
            self._heard_at_s = time.monotonic()
            self._urgent |= (message.state, message.hold_reason) != self._state
            self._state = (message.state, message.hold_reason)
            self._newest["status"] = StatusArrived(message)
        elif isinstance(message, ResultProgress):
            self._newest["progress"] = ProgressArrived(message)
        elif isinstance(message, ResultEnd):
            self._tell(ResultsOnDisk(message))
        elif isinstance(message, Reply):
            pending = self._pending.pop(message.request_id, None)
            if pending is not None:
                self._tell(_answer(pending.command, message))

    def _tell(self, message: UiMessage) -> None:
        self._told.append(message)

    def _paint(self) -> None:
        """Tell the screen what is new, unless it still has not taken what it was told last: then the newest waits."""
        now_s = time.monotonic()
        due = bool(self._newest) and (self._urgent or now_s - self._painted_at_s >= PAINT_S)
        if self._unseen.is_set() or not (due or self._told):
            return
        parts = list(self._told)
        self._told.clear()
        if due:
            self._painted_at_s, self._urgent = now_s, False
            parts += self._newest.values()
            self._newest.clear()
        self._unseen.set()
        self._post(News(parts, self._taken))

    def _taken(self) -> None:
        self._unseen.clear()
        with suppress(OSError):  # the link was closed meanwhile
            os.eventfd_write(self._wake, 1)

    def _judge_link(self, run_dir: Path, listening_since_s: float) -> bool:
        now_s = time.monotonic()
        if self._heard_at_s is not None and now_s - self._heard_at_s < AWAY_S:
            self._set_connected(True, str(run_dir))
            return False
        if now_s - (self._heard_at_s or listening_since_s) >= AWAY_S:
            self._set_connected(False, f"no rig daemon is heard in {run_dir}")
            return True
        return False

    def _set_connected(self, connected: bool, detail: str) -> None:
        if connected != self._connected:
            self._connected = connected
            self._tell(LinkChanged(connected, detail))
            self._paint()

    def _moved(self, run_dir: Path) -> bool:
        try:
            return client_run_dir() != run_dir
        except NoServiceError:
            return False

    def _look(self, run_dir: Path) -> None:
        now_s = time.monotonic()
        if now_s - self._looked_at_s < LOOK_S:
            return
        self._looked_at_s = now_s
        url = read_url(run_dir)
        if url != self._url:
            self._url = url
            self._tell(PageKnown(url))

    def _send_outbox(self, sockets: _Sockets) -> None:
        for command in self._queued():
            # a command that waited in a queue for the daemon to come back would move the stage when nobody expects it
            if (not self._connected and command.name != "stop") or not sockets.sender.send(command):
                self._fail(command, "not sent: the rig daemon is not connected")
                continue
            now_s = time.monotonic()
            self._pending[command.request_id] = _Pending(
                command, now_s + self._command_timeout_s / 2, now_s + self._command_timeout_s
            )

    def _fail(self, command: Command, why: str) -> None:
        now_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
        self._tell(CommandAnswered(command.name, False, why, now_ns, command.request_id))
        self._paint()

    def _refuse_outbox(self) -> None:
        for command in self._queued():
            self._fail(command, "not sent: the rig daemon is not connected")

    def _queued(self) -> list[Command]:
        commands = []
        with suppress(queue.Empty):
            while True:
                commands.append(self._outbox.get_nowait())
        return commands

    def _chase(self, sockets: _Sockets) -> None:
        now_s = time.monotonic()
        for request_id, pending in list(self._pending.items()):
            if now_s >= pending.give_up_at_s:
                del self._pending[request_id]
                detail = f"no answer within {self._command_timeout_s:g} s: whether it was done is not known"
                self._fail(pending.command, detail)
            elif now_s >= pending.resend_at_s and not pending.resent:
                pending.resent = True
                sockets.sender.send(pending.command)


class _Sockets:
    """The lanes of a console."""

    def __init__(self, context: zmq.Context[Any], run_dir: Path) -> None:
        self.status = connect(context, zmq.SUB, run_dir, "status")
        self.results = connect(context, zmq.SUB, run_dir, "results")
        self.preview = open_socket(context, zmq.SUB, "preview")
        self.preview.setsockopt(zmq.RECONNECT_IVL, 50)
        self.preview.setsockopt(zmq.RECONNECT_IVL_MAX, 500)
        self.preview.connect(endpoint(run_dir, "preview"))
        self._listening = False
        self.command = open_socket(context, zmq.DEALER, "command")
        self.command.setsockopt(zmq.IMMEDIATE, 1)  # nothing is queued for a daemon that is not there
        self.command.setsockopt(zmq.RECONNECT_IVL, 50)
        self.command.setsockopt(zmq.RECONNECT_IVL_MAX, 500)
        self.command.connect(endpoint(run_dir, "command"))
        self.sender = Sender(self.command)

    def listen_to_pictures(self, wanted: bool) -> None:
        """Subscribe to pictures, or no longer: the daemon makes none for nobody."""
        if wanted != self._listening:
            self._listening = wanted
            self.preview.setsockopt(zmq.SUBSCRIBE if wanted else zmq.UNSUBSCRIBE, b"")

    def poll(self, wake: int) -> list[tuple[Any, int]]:
        """What is readable now, waiting a little."""
        poller = zmq.Poller()
        for source in (wake, self.status, self.results, self.preview, self.command):
            poller.register(source, zmq.POLLIN)
        return poller.poll(POLL_MS)


def _drain(socket: zmq.Socket[Any]) -> list[Received]:
    """All messages that are waiting; unreadable ones are passed over."""
    waiting: list[Received] = []
    while True:
        try:
            received = receive(socket)
        except ProtocolError:
            continue
        if received is None:
            return waiting
        waiting.append(received)


def _picture(received: Received) -> PictureView:
    assert isinstance(received.message, Picture) and received.payload is not None
    return PictureView.of(received.message, received.payload.bytes)


def _maps(received: Received) -> MapsView:
    assert isinstance(received.message, ResultMaps) and received.payload is not None
    return MapsView.of(received.message, received.payload.bytes)


def _answer(command: Command, reply: Reply) -> CommandAnswered:
    detail = reply.error if not reply.ok else str(reply.result.get("path", ""))
    return CommandAnswered(command.name, reply.ok, detail, reply.sent_mono_ns, command.request_id, dict(reply.result))
