"""Commands of the console on their way: each is sent once (and once again), answered or given up, and that is told.

A command that waited for a daemon to come back would move the stage when nobody expects it: it is refused instead.
STOP alone is handed over in any case.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from acquire.contract.messaging.lanes import Sender
from acquire.contract.messaging.messages import Command, Reply
from tui.console.link.messages import CommandAnswered

AWAY = "not sent: the rig daemon is not connected"


@dataclass
class _Pending:
    command: Command
    sent_mono_ns: int
    resend_at_s: float
    give_up_at_s: float
    resent: bool = False


class Errands:
    """Any thread puts commands in; one thread does the rest."""

    def __init__(self, tell: Callable[[CommandAnswered], None], timeout_s: float) -> None:
        """``tell`` is called from the one thread; a reply is waited for ``timeout_s``."""
        self._tell, self._timeout_s = tell, timeout_s
        self._outbox: queue.SimpleQueue[Command] = queue.SimpleQueue()
        self._pending: dict[str, _Pending] = {}

    def put(self, command: Command) -> None:
        """Have a command sent. Safe from any thread."""
        self._outbox.put(command)

    def send(self, sender: Sender, *, connected: bool) -> None:
        """Send what was put in."""
        for command in self._queued():
            sent_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
            if (not connected and command.name != "stop") or not sender.send(command, sent_mono_ns=sent_ns):
                self._fail(command, AWAY)
                continue
            now_s = time.monotonic()
            give_up_at_s = now_s + self._timeout_s
            self._pending[command.request_id] = _Pending(command, sent_ns, now_s + self._timeout_s / 2, give_up_at_s)

    def refuse(self) -> None:
        """There is nobody to send to; what was sent before is given up when its time has come."""
        for command in self._queued():
            self._fail(command, AWAY)
        self._give_up(time.monotonic())

    def answered(self, reply: Reply) -> None:
        """A reply came; one that nobody waits for any more is passed over."""
        pending = self._pending.pop(reply.request_id, None)
        if pending is None:
            return
        detail = reply.error if not reply.ok else str(reply.result.get("path", ""))
        name = pending.command.name
        self._tell(CommandAnswered(name, reply.ok, detail, reply.sent_mono_ns, reply.request_id, dict(reply.result)))

    def chase(self, sender: Sender) -> None:
        """Send again what has no answer yet (the daemon does nothing twice), and give up in the end.

        It goes with the time of its first sending: a daemon that was restarted remembers no request, only its age
        tells that it is too late.
        """
        now_s = time.monotonic()
        self._give_up(now_s)
        for pending in self._pending.values():
            if now_s >= pending.resend_at_s and not pending.resent:
                pending.resent = True
                sender.send(pending.command, sent_mono_ns=pending.sent_mono_ns)

    def _give_up(self, now_s: float) -> None:
        for request_id, pending in list(self._pending.items()):
            if now_s >= pending.give_up_at_s:
                del self._pending[request_id]
                detail = f"no answer within {self._timeout_s:g} s: whether it was done is not known"
                self._fail(pending.command, detail)

    def _queued(self) -> list[Command]:
        commands = []
        with suppress(queue.Empty):
            while True:
                commands.append(self._outbox.get_nowait())
        return commands

    def _fail(self, command: Command, why: str) -> None:
        now_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
        self._tell(CommandAnswered(command.name, False, why, now_ns, command.request_id))
