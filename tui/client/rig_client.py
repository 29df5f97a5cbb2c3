"""Talks to the daemon: one reply or one error per request, and the newest status; owns its sockets."""

from __future__ import annotations

import socket
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import zmq

from acquire.contract.errors import CommandRefusedError, NoServiceError, ProtocolError
from acquire.contract.messaging.lanes import Sender, connect, receive
from acquire.contract.messaging.messages import Command, Message, Reply, ResultEnd, ResultProgress, Status


def somebody_listens(run_dir: Path, lane: str = "command") -> bool:
    """True if a living process has the lane's socket bound (a socket file alone may be left from a dead one)."""
    with socket.socket(socket.AF_UNIX) as probe:
        try:
            probe.connect(str(run_dir / f"{lane}.sock"))
        except OSError:
            return False
    return True


def new_request(name: str, args: dict[str, Any], client: str = "") -> Command:
    """A command with a request id of its own; arguments that are None are left out."""
    given = {key: value for key, value in args.items() if value is not None}
    return Command(request_id=uuid.uuid4().hex, name=name, args=given, client=client)


class RigClient:
    """A client of the command and status lanes; use it in a ``with`` block and in one thread."""

    def __init__(self, run_dir: Path, *, timeout_s: float = 5.0, client: str = "") -> None:
        """Connect to the daemon in ``run_dir``; ``client`` is who asks, in words.

        Raises:
            NoServiceError: nobody listens there.
        """
        if not somebody_listens(run_dir):
            raise _nobody(run_dir)
        self.run_dir, self.client = run_dir, client
        self._timeout_s = timeout_s
        self._context = zmq.Context()
        self._socket = connect(self._context, zmq.DEALER, run_dir, "command")
        self._sender = Sender(self._socket)
        self._status = connect(self._context, zmq.SUB, run_dir, "status")

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
        command = new_request(name, args, self.client)
        sent_mono_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
        for _attempt in range(2):
            # the second sending is as old as the first: a daemon that was restarted must be able to find it too late
            self._sender.send(command, sent_mono_ns=sent_mono_ns)
            reply = self._reply_to(command.request_id, self._timeout_s / 2)
            if reply is not None:
                if not reply.ok:
                    raise CommandRefusedError(f"{name} was refused: {reply.error}")
                return reply
        raise NoServiceError(
            f"the rig daemon did not answer '{name}' within {self._timeout_s:g} s: whether it was done is not known; "
            "see 'sweepscope status'"
        )

    def _reply_to(self, request_id: str, timeout_s: float) -> Reply | None:
        deadline_s = time.monotonic() + timeout_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            message = _next_message(self._socket, left_s)
            if isinstance(message, Reply) and message.request_id == request_id:
                return message
        return None

    def newest_status(self, timeout_s: float) -> Status | None:
        """The newest status that has arrived, waiting up to ``timeout_s`` for one; None if none came."""
        newest: Status | None = None
        deadline_s = time.monotonic() + timeout_s
        while newest is None and (left_s := deadline_s - time.monotonic()) > 0:
            message = _next_message(self._status, left_s)
            while message is not None:
                newest = message if isinstance(message, Status) else newest
                message = _next_message(self._status, 0)
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
        self._socket = connect(self._context, zmq.SUB, run_dir, "results")
        self._newest: ResultProgress | None = None
        self._ends: dict[str, ResultEnd] = {}

    def end_of(self, scan_uid: str) -> ResultEnd | None:
        """What the worker said when the scan's maps and cloud were on disk; None if that was not heard. Never waits."""
        self.newest()
        return self._ends.get(scan_uid)

    def newest(self) -> ResultProgress | None:
        """What was heard last; None if nothing was. Never waits."""
        while self._socket.poll(0):
            message = _next_message(self._socket, 0)
            if isinstance(message, ResultProgress):
                self._newest = message
            elif isinstance(message, ResultEnd):
                self._ends.setdefault(message.scan_uid, message)
        return self._newest

    def close(self) -> None:
        """Close the socket."""
        self._context.destroy(linger=0)


def _next_message(source: zmq.Socket[Any], timeout_s: float) -> Message | None:
    """The next readable message; unreadable ones are passed over (F20: they never stop a client)."""
    if not source.poll(max(0, int(timeout_s * 1000))):
        return None
    try:
        received = receive(source)
    except ProtocolError:
        return None
    return received.message if received is not None else None


def _nobody(run_dir: Path) -> NoServiceError:
    return NoServiceError(
        f"no rig daemon answers in {run_dir}: start one with 'sweepscope up', or set SWEEPSCOPE_RUN to its directory"
    )
