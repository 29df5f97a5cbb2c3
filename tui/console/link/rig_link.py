"""The console's one input thread: owns its sockets, survives any absence of the daemon, and never blocks the screen."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import zmq
from textual.message import Message as UiMessage

from acquire.contract.errors import NoServiceError, ProtocolError, SweepscopeError
from acquire.contract.messaging.lanes import Received, Sender, arrived, connect, open_socket
from acquire.contract.messaging.messages import Message, Picture, Reply, ResultEnd, ResultMaps, ResultProgress, Status
from acquire.contract.process.run_dir import client_run_dir, endpoint
from tui.client.rig_client import new_request
from tui.console.link.messages import (
    LinkChanged,
    MapsArrived,
    PageKnown,
    PictureArrived,
    ProgressArrived,
    ResultsOnDisk,
    StatusArrived,
)
from tui.console.link.requests import Errands
from tui.console.link.rig_view import MapsView, PictureView
from tui.console.link.update_queue import NewsDesk
from tui.processes.all_services import read_url

AWAY_S = 1.5
"""No status for so long means that the daemon is away (it sends five per second)."""
LOOK_S = 1.0
"""How often directories and the page's address are looked at."""
POLL_MS = 100
MOST_AT_ONCE = 10_000
"""Messages of one lane that are taken in one turn."""


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
        self._client = client
        self._run_dir = run_dir
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="rig-link", daemon=True)
        self._news = NewsDesk(post, self._wake_up)
        self._errands = Errands(self._news.tell, command_timeout_s)
        self._state: tuple[str, str] = ("", "")
        self._pictures_wanted = threading.Event()
        self._heard_at_s: float | None = None
        self._connected: bool | None = None
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
        self._errands.put(command)
        os.eventfd_write(self._wake, 1)
        return command.request_id

    def _wake_up(self) -> None:
        with suppress(OSError):  # the link was closed meanwhile
            os.eventfd_write(self._wake, 1)

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
                self._errands.refuse()
                self._news.paint()
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
            self._errands.refuse()
            self._news.paint()
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
                self._take_all(list(arrived(socket, MOST_AT_ONCE)))
        self._errands.send(sockets.sender, connected=bool(self._connected))
        self._errands.chase(sockets.sender)
        self._news.paint()

    def _take_all(self, waiting: list[Received]) -> None:
        pictures = [received for received in waiting if isinstance(received.message, Picture)]
        maps = [received for received in waiting if isinstance(received.message, ResultMaps)]
        for received in waiting:
            self._take(received.message)
        with suppress(ProtocolError):
            if pictures and pictures[-1].payload is not None:
                self._news.show("picture", PictureArrived(_picture(pictures[-1])))
            if maps and maps[-1].payload is not None:
                self._news.show("maps", MapsArrived(_maps(maps[-1])))

    def _take(self, message: Message) -> None:
        if isinstance(message, Status):
            self._heard_at_s = time.monotonic()
            before, self._state = self._state, (message.state, message.hold_reason)
            self._news.show("status", StatusArrived(message), urgent=self._state != before)
        elif isinstance(message, ResultProgress):
            self._news.show("progress", ProgressArrived(message))
        elif isinstance(message, ResultEnd):
            self._news.tell(ResultsOnDisk(message))
        elif isinstance(message, Reply):
            self._errands.answered(message)

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
            self._news.tell(LinkChanged(connected, detail))
            self._news.paint()

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
            self._news.tell(PageKnown(url))


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


def _picture(received: Received) -> PictureView:
    assert isinstance(received.message, Picture) and received.payload is not None
    return PictureView.of(received.message, received.payload.bytes)


def _maps(received: Received) -> MapsView:
    assert isinstance(received.message, ResultMaps) and received.payload is not None
    return MapsView.of(received.message, received.payload.bytes)
