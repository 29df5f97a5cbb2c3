"""The console's input thread: feeds the screen with the rig's state and carries its commands.

It survives any absence of the daemon and never blocks the screen.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import zmq

from acquire.contract.errors import NoServiceError, ProtocolError, SweepscopeError
from acquire.contract.messaging.lanes import Received, Sender, arrived, connect
from acquire.contract.messaging.messages import Picture, Reply, ResultEnd, ResultMaps, ResultProgress, Status
from acquire.contract.process.run_dir import client_run_dir
from acquire.contract.rig_client.commands import RETRY_MS, CommandClient, CommandState, CommandUpdate, new_command
from acquire.contract.rig_client.feed import RigFeed
from tui.console.link.messages import (
    CommandAnswered,
    LinkChanged,
    MapsArrived,
    PageKnown,
    PictureArrived,
    ProgressArrived,
    ResultsOnDisk,
    StatusArrived,
    Updates,
)
from tui.console.link.rig_view import MapsView, PictureView
from tui.console.link.update_queue import UpdateQueue
from tui.processes.all_services import read_url

AWAY_S = 1.5
"""No status for so long means that the daemon is away (it sends five per second)."""
LOOK_S = 1.0
"""How often directories and the page's address are looked at."""
POLL_MS = 100
MOST_AT_ONCE = 10_000
"""Messages of one lane that are taken in one turn."""
_NOT_SENT = {
    CommandState.NO_DAEMON: "not sent: the rig daemon is not connected",
    CommandState.STALE: "not sent in time: this console was held up; nothing has moved",
}


class RigLink:
    """Feeds a screen with the rig's state and carries its commands; everything else happens in its thread."""

    def __init__(
        self,
        post: Callable[[Updates], Any],
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
        self._updates = UpdateQueue(post, self._wake_up)
        self._command_timeout_s = command_timeout_s
        self._commands = CommandClient(self._post_end, command_timeout_s)
        self._state: tuple[str, str] = ("", "")
        self._pictures_wanted = threading.Event()
        self._status_at_s: float | None = None
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
        command = new_command(name, args, self._client)
        self._commands.put(command)
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
                self._wait_without_daemon()

    def _wait_without_daemon(self) -> None:
        """Refuse what is asked meanwhile, look again later."""
        self._commands.turn(None)
        self._updates.paint()
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
            sockets = _Sockets(context, run_dir, self._wake)
        except SweepscopeError as error:
            context.destroy(linger=0)
            self._set_connected(False, str(error))
            self._wait_without_daemon()
            return
        self._status_at_s = None
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
        sockets.wait(RETRY_MS if self._commands.connecting else POLL_MS)
        with suppress(BlockingIOError):
            os.eventfd_read(self._wake)
        sockets.feed.want_pictures(self._pictures_wanted.is_set())
        for received in arrived(sockets.command, MOST_AT_ONCE):
            if isinstance(received.message, Reply):
                self._commands.take(received.message)
        for lane in sockets.feed.sockets:
            for received in sockets.feed.arrived(lane, MOST_AT_ONCE):
                with suppress(ProtocolError):  # pixels or maps that do not fit their header
                    self._take(received)
        self._commands.turn(sockets.sender, connected=bool(self._connected))
        self._updates.paint()

    def _take(self, received: Received) -> None:
        message = received.message
        if isinstance(message, Status):
            self._status_at_s = time.monotonic()
            before, self._state = self._state, (message.state, message.hold_reason)
            self._updates.show("status", StatusArrived(message), urgent=self._state != before)
        elif isinstance(message, ResultProgress):
            self._updates.show("progress", ProgressArrived(message))
        elif isinstance(message, ResultEnd):
            self._updates.tell(ResultsOnDisk(message))
        elif isinstance(message, Picture):
            self._updates.show("picture", PictureArrived(PictureView.of(message, received.buffer)))
        elif isinstance(message, ResultMaps):
            self._updates.show("maps", MapsArrived(MapsView.of(message, received.buffer)))

    def _post_end(self, update: CommandUpdate) -> None:
        """Tell the screen how a command ended; that it was sent is not posted."""
        if update.state is CommandState.SENT:
            return
        command, reply = update.command, update.reply
        if reply is not None:
            detail = str(reply.result.get("path", "")) if reply.ok else reply.error
        elif update.state is CommandState.NO_ANSWER:
            detail = f"no answer within {self._command_timeout_s:g} s: whether it was done is not known"
        else:
            detail = _NOT_SENT[update.state]
        ok, result = (reply.ok, dict(reply.result)) if reply is not None else (False, {})
        self._updates.tell(CommandAnswered(command.name, ok, detail, update.at_mono_ns, command.request_id, result))

    def _judge_link(self, run_dir: Path, listening_since_s: float) -> bool:
        now_s = time.monotonic()
        if self._status_at_s is not None and now_s - self._status_at_s < AWAY_S:
            self._set_connected(True, str(run_dir))
            return False
        if now_s - (self._status_at_s or listening_since_s) >= AWAY_S:
            self._set_connected(False, f"no rig daemon answers in {run_dir}")
            return True
        return False

    def _set_connected(self, connected: bool, detail: str) -> None:
        if connected != self._connected:
            self._connected = connected
            self._updates.tell(LinkChanged(connected, detail))
            self._updates.paint()

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
            self._updates.tell(PageKnown(url))


class _Sockets:
    """The lanes of a console."""

    def __init__(self, context: zmq.Context[Any], run_dir: Path, wake: int) -> None:
        self.feed = RigFeed(context)
        self.feed.connect(run_dir)
        self.command = connect(context, zmq.DEALER, run_dir, "command", immediate=True)
        self.sender = Sender(self.command)
        self._poller = zmq.Poller()
        for source in (wake, self.command, *self.feed.sockets.values()):
            self._poller.register(source, zmq.POLLIN)

    def wait(self, timeout_ms: int) -> None:
        """Wait for a message, or for ``wake``."""
        self._poller.poll(timeout_ms)
