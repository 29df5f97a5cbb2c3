"""Commands on their way to the daemon: sent, sent once more, then answered or given up. Pure but for the clock.

A command that waited for a daemon to come back would move the stage unexpectedly. So a command goes to a
daemon that is there now or is refused, and one that waited too long because this process was frozen is not sent.
STOP alone is sent however late it is, and to a daemon that is silent.
"""

from __future__ import annotations

import uuid
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final, Protocol

from acquire.contract.messaging.messages import Command, Reply
from acquire.contract.process.clocks import Clock, MonotonicClock
from acquire.contract.units import NS_PER_MS, NS_PER_S

STALE_NS: Final = NS_PER_S
"""A command that waited longer for its sending is not sent."""
STALE_BEAT_NS: Final = 250 * NS_PER_MS
"""The same for ``jog_hold``: calls that bunched up must not move the stage after the button was let go."""
CONNECTING_NS: Final = 300 * NS_PER_MS
"""Sending is tried for so long: the sockets of a daemon that has just started connect one after the other."""
RETRY_MS: Final = 20
"""How soon :meth:`CommandClient.turn` is to be called again while :attr:`CommandClient.connecting`."""


class CommandState(Enum):
    """What became of a command."""

    SENT = "sent"
    DONE = "done"
    REFUSED = "refused"
    """The daemon's reply says why."""
    NO_DAEMON = "no daemon"
    """Not sent: there is no daemon that would take it."""
    STALE = "stale"
    """Not sent: it waited too long in this process."""
    NO_ANSWER = "no answer"
    """Sent, but no reply came in time: whether it was done is not known."""


@dataclass(frozen=True)
class CommandUpdate:
    """One thing that happened to one command."""

    command: Command
    state: CommandState
    at_mono_ns: int
    """CLOCK_MONOTONIC of the daemon's reply, or of the decision made here."""
    reply: Reply | None = None
    """The daemon's reply; None unless the state is DONE or REFUSED."""


class CommandSender(Protocol):
    """The sending half of a command socket: :class:`acquire.contract.messaging.lanes.Sender`."""

    def send(self, message: Command, *, sent_mono_ns: int) -> bool:
        """Hand the command over without blocking; False if no daemon is connected."""


@dataclass(frozen=True)
class _Waiting:
    command: Command
    asked_ns: int
    once: bool


@dataclass
class _Pending:
    command: Command
    sent_ns: int
    once: bool
    repeated: bool = False


def new_command(name: str, args: dict[str, Any], client: str = "") -> Command:
    """A command with a request id of its own; arguments that are None are left out."""
    given = {key: value for key, value in args.items() if value is not None}
    return Command(request_id=uuid.uuid4().hex, name=name, args=given, client=client)


class CommandClient:
    """Any thread may :meth:`put` commands in; one thread calls the rest."""

    def __init__(self, tell: Callable[[CommandUpdate], None], timeout_s: float, clock: Clock | None = None) -> None:
        """``tell`` is called from the one thread; a reply is waited for ``timeout_s`` after the first sending."""
        self._tell, self._clock = tell, clock or MonotonicClock()
        self._timeout_ns = round(timeout_s * NS_PER_S)
        self._waiting: deque[_Waiting] = deque()
        self._pending: dict[str, _Pending] = {}

    @property
    def connecting(self) -> bool:
        """True while a command waits for a connection: call :meth:`turn` again after ``RETRY_MS``."""
        return bool(self._waiting)

    def put(self, command: Command, *, once: bool = False) -> None:
        """Have a command sent in the next :meth:`turn`.

        Args:
            command: from :func:`new_command`.
            once: pass it over while another one with this name and this mark waits for its reply.
        """
        self._waiting.append(_Waiting(command, self._clock.now_ns(), once))

    def turn(self, sender: CommandSender | None, *, connected: bool = True) -> None:
        """Send what waits, send again what has no reply yet, give up what is overdue.

        Args:
            sender: None if there is no socket.
            connected: False if the daemon is silent: then nothing but STOP is sent.
        """
        now_ns = self._clock.now_ns()
        self._give_up(now_ns)
        while self._waiting and self._is_settled(self._waiting[0], sender, connected, now_ns):
            self._waiting.popleft()
        if sender is not None:
            self._repeat(sender, now_ns)

    def take(self, reply: Reply) -> None:
        """A reply came; one that is not waited for any more is ignored."""
        pending = self._pending.pop(reply.request_id, None)
        if pending is not None:
            state = CommandState.DONE if reply.ok else CommandState.REFUSED
            self._tell(CommandUpdate(pending.command, state, reply.sent_mono_ns, reply))

    def _is_settled(self, waiting: _Waiting, sender: CommandSender | None, connected: bool, now_ns: int) -> bool:
        """Send the first of those that wait, or refuse it; False if it is to be tried again."""
        command, age_ns = waiting.command, now_ns - waiting.asked_ns
        is_stop = command.name == "stop"
        if waiting.once and any(sent.once and sent.command.name == command.name for sent in self._pending.values()):
            return True
        if sender is None or not (connected or is_stop):
            state = CommandState.NO_DAEMON
        elif not is_stop and age_ns > (STALE_BEAT_NS if command.name == "jog_hold" else STALE_NS):
            state = CommandState.STALE
        elif sender.send(command, sent_mono_ns=now_ns):
            self._pending[command.request_id] = _Pending(command, now_ns, waiting.once)
            state = CommandState.SENT
        elif age_ns <= CONNECTING_NS:
            return False
        else:
            state = CommandState.NO_DAEMON
        self._tell(CommandUpdate(command, state, now_ns))
        return True

    def _repeat(self, sender: CommandSender, now_ns: int) -> None:
        """Send a second time after half of the time-out: the daemon does nothing twice.

        It goes with the time of its first sending: a daemon that was restarted remembers no request, and only its age
        tells that it is too late.
        """
        for pending in self._pending.values():
            if not pending.repeated and now_ns - pending.sent_ns >= self._timeout_ns // 2:
                pending.repeated = True
                sender.send(pending.command, sent_mono_ns=pending.sent_ns)

    def _give_up(self, now_ns: int) -> None:
        for request_id, pending in list(self._pending.items()):
            if now_ns - pending.sent_ns >= self._timeout_ns:
                del self._pending[request_id]
                self._tell(CommandUpdate(pending.command, CommandState.NO_ANSWER, now_ns))
