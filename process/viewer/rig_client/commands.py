"""The page's commands to the daemon: one thread sends them in the order of the clicks and collects the replies."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zmq

from acquire.contract.messaging.lanes import Sender, arrived, connect
from acquire.contract.messaging.messages import Command, Reply
from acquire.contract.permissions import accepted_words
from acquire.contract.process.clocks import Clock, MonotonicClock
from acquire.contract.rig_client.commands import RETRY_MS, CommandClient, CommandState, CommandUpdate, new_command

POLL_MS = 200
MOST_AT_ONCE = 64
"""Replies that are taken in one turn."""
JOIN_TIMEOUT_S = 5.0


@dataclass(frozen=True)
class CommandNote:
    """What became of the last click, for people."""

    text: str = ""
    ok: bool = True
    at_ns: int = 0


class CommandThread:
    """Sends commands from a thread of its own; :meth:`submit` never blocks and is safe from any thread."""

    def __init__(
        self, run_dir: Path, timeout_s: float, on_note: Callable[[], None] = lambda: None, clock: Clock | None = None
    ) -> None:
        """``timeout_s``: how long a reply is waited for (limits.command_s); ``on_note`` is called from the thread."""
        self._run_dir, self._timeout_s, self._on_note = run_dir, timeout_s, on_note
        self._clock = clock or MonotonicClock()
        self._commands = CommandClient(self._take_update, timeout_s, self._clock)
        self._closing = False
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._thread = threading.Thread(target=self._run, name="viewer-commands")
        self.note = CommandNote()
        """What became of the last click."""

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def close(self) -> None:
        """End the thread and close its socket; requests without a reply are given up."""
        self._closing = True
        os.eventfd_write(self._wake, 1)
        self._thread.join(JOIN_TIMEOUT_S)
        os.close(self._wake)

    def submit(self, name: str, args: dict[str, Any] | None = None, *, client: str = "") -> None:
        """Have one command sent in the name of ``client``; a second click while the first is under way is none."""
        command = new_command(name, args or {}, client)
        self._commands.put(command, once=name != "stop" and not _is_beat(command))
        os.eventfd_write(self._wake, 1)

    # ---- in the thread ----

    def _run(self) -> None:
        context: zmq.Context[Any] = zmq.Context()
        socket = connect(context, zmq.DEALER, self._run_dir, "command", immediate=True)
        try:
            self._talk(socket)
        finally:
            socket.close(0)
            context.term()

    def _talk(self, socket: zmq.Socket[Any]) -> None:
        sender = Sender(socket)
        poller = zmq.Poller()
        for source in (self._wake, socket):
            poller.register(source, zmq.POLLIN)
        while not self._closing:
            poller.poll(RETRY_MS if self._commands.connecting else POLL_MS)
            with suppress(BlockingIOError):
                os.eventfd_read(self._wake)
            for received in arrived(socket, MOST_AT_ONCE):
                if isinstance(received.message, Reply):
                    self._commands.take(received.message)
            self._commands.turn(sender)

    def _take_update(self, update: CommandUpdate) -> None:
        is_beat, ok = _is_beat(update.command), update.state in (CommandState.SENT, CommandState.DONE)
        if is_beat and (ok or update.state is CommandState.STALE):
            return  # one of many that follow each other
        self.note = CommandNote(f"{update.command.name}{self._words(update)}", ok, self._clock.now_ns())
        self._on_note()

    def _words(self, update: CommandUpdate) -> str:
        error = update.reply.error if update.reply is not None else ""
        return {
            CommandState.SENT: " ...",
            CommandState.DONE: f": {accepted_words(update.command.name)}",
            CommandState.REFUSED: f" was refused: {error}",
            CommandState.NO_DAEMON: " was not sent: no rig daemon answers; start it with 'sweepscope up'",
            CommandState.STALE: " was not sent in time; nothing has moved",
            CommandState.NO_ANSWER: f": no answer within {self._timeout_s:g} s; look at the state of the rig",
        }[update.state]


def _is_beat(command: Command) -> bool:
    """True for calls that repeat while a button is held or control is kept: only a refusal of one is worth a note."""
    return command.name == "jog_hold" or command.args.get("action") == "renew"
