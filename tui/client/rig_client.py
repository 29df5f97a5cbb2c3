"""Talks to the daemon and blocks until it has answered: one reply or one error per request, and the newest status."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import zmq

from acquire.contract.errors import CommandRefusedError, NoServiceError
from acquire.contract.messaging.lanes import Sender, arrived, connect
from acquire.contract.messaging.messages import Reply, ResultEnd, ResultProgress, Status
from acquire.contract.process.run_dir import is_served
from acquire.contract.rig_client.commands import CommandClient, CommandState, CommandUpdate, new_command
from acquire.contract.rig_client.feed import RigFeed

LOOK_MS = 50
"""How often a request that waits for its reply looks at its deadlines."""
MOST_AT_ONCE = 1000
"""Messages taken in one turn; more of them stay in the socket."""


class RigClient:
    """A client of the command and status lanes; use it in a ``with`` block and in one thread."""

    def __init__(self, run_dir: Path, *, timeout_s: float = 5.0, client: str = "") -> None:
        """Connect to the daemon in ``run_dir``; ``client`` is the name of this client.

        Raises:
            NoServiceError: no daemon answers there.
        """
        if not is_served(run_dir):
            raise NoServiceError(
                f"no rig daemon answers in {run_dir}: start one with 'sweepscope up', "
                "or set SWEEPSCOPE_RUN to its directory"
            )
        self.run_dir, self.client = run_dir, client
        self._timeout_s = timeout_s
        self._context = zmq.Context()
        self._socket = connect(self._context, zmq.DEALER, run_dir, "command")
        self._sender = Sender(self._socket)
        self._feed = RigFeed(self._context, "status")
        self._feed.connect(run_dir)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the sockets; what was not sent is dropped."""
        self._context.destroy(linger=0)

    def request(self, name: str, /, **args: Any) -> Reply:
        """Ask the daemon and wait for its reply; sent once more with the same id when half the time has passed.

        Raises:
            NoServiceError: no reply in time.
            CommandRefusedError: the daemon says no, and why.
        """
        updates: list[CommandUpdate] = []
        commands = CommandClient(updates.append, self._timeout_s)
        commands.put(new_command(name, args, self.client))
        commands.turn(self._sender)
        while updates[-1].state is CommandState.SENT:
            self._socket.poll(LOOK_MS)
            for received in arrived(self._socket, MOST_AT_ONCE):
                if isinstance(received.message, Reply):
                    commands.take(received.message)
            commands.turn(self._sender)
        reply = updates[-1].reply
        if reply is None:
            raise NoServiceError(
                f"the rig daemon did not answer '{name}' within {self._timeout_s:g} s: whether it was done is not "
                "known; see 'sweepscope status'"
            )
        if not reply.ok:
            raise CommandRefusedError(f"{name} was refused: {reply.error}")
        return reply

    def newest_status(self, timeout_s: float) -> Status | None:
        """The newest status that has arrived, waiting up to ``timeout_s`` for one; None if none came."""
        newest: Status | None = None
        deadline_s = time.monotonic() + timeout_s
        while newest is None and (left_s := deadline_s - time.monotonic()) > 0:
            self._feed.sockets["status"].poll(round(1000 * left_s))
            for received in self._feed.arrived("status", MOST_AT_ONCE):
                newest = received.message if isinstance(received.message, Status) else newest
        return newest

    def status(self) -> Status:
        """The rig's state now.

        Raises:
            NoServiceError: the daemon says nothing.
        """
        status = self.newest_status(self._timeout_s)
        if status is None:
            raise NoServiceError(
                f"the rig daemon in {self.run_dir} sent no status within {self._timeout_s:g} s: "
                "look at its log, or start it again"
            )
        return status

    def wait_for(self, wanted: Callable[[Status], bool], timeout_s: float) -> Status | None:
        """The first newest status that is ``wanted``; None if there was none in time."""
        deadline_s = time.monotonic() + timeout_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            status = self.newest_status(min(left_s, 1.0))
            if status is not None and wanted(status):
                return status
        return None


class ProgressFeed:
    """The worker's newest progress and its last end, for a process that looks now and then; use it in one thread."""

    def __init__(self, run_dir: Path) -> None:
        self._context: zmq.Context[Any] = zmq.Context()
        self._feed = RigFeed(self._context, "results")
        self._feed.connect(run_dir)
        self._newest: ResultProgress | None = None
        self._ends: dict[str, ResultEnd] = {}

    def end_of(self, scan_uid: str) -> ResultEnd | None:
        """The worker's message that the scan's maps and cloud are on disk; None if it did not come. Never waits."""
        self.newest()
        return self._ends.get(scan_uid)

    def newest(self) -> ResultProgress | None:
        """The newest progress; None if none came. Never waits."""
        for received in self._feed.arrived("results", MOST_AT_ONCE):
            if isinstance(received.message, ResultProgress):
                self._newest = received.message
            elif isinstance(received.message, ResultEnd):
                self._ends.setdefault(received.message.scan_uid, received.message)
        return self._newest

    def close(self) -> None:
        """Close the socket."""
        self._context.destroy(linger=0)
