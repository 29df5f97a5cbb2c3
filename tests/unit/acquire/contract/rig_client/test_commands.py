"""The rules that command line, console and page share, with a clock and a socket that the test plays."""

from __future__ import annotations

import pytest

from acquire.contract.messaging.messages import Command, Reply
from acquire.contract.rig_client.commands import (
    CONNECTING_NS,
    STALE_BEAT_NS,
    STALE_NS,
    CommandClient,
    CommandState,
    new_command,
)
from acquire.contract.units import NS_PER_MS, NS_PER_S

SENT, DONE, REFUSED = CommandState.SENT, CommandState.DONE, CommandState.REFUSED
NO_DAEMON, STALE, NO_ANSWER = CommandState.NO_DAEMON, CommandState.STALE, CommandState.NO_ANSWER
TIMEOUT_S = 4.0


class Line:
    """A clock, and the sending half of a socket whose other end the test may take away."""

    def __init__(self) -> None:
        self.ns = 100 * NS_PER_S
        self.there = True
        self.sent: list[tuple[str, str, int]] = []
        """Name, request id and time stamp of what was sent."""
        self.told: list[tuple[str, CommandState]] = []
        self.replies: list[Reply | None] = []
        self.client = CommandClient(self._tell, TIMEOUT_S, self)

    def now_ns(self) -> int:
        return self.ns

    def send(self, message: Command, *, sent_mono_ns: int) -> bool:
        if self.there:
            self.sent.append((message.name, message.request_id, sent_mono_ns))
        return self.there

    def put(self, name: str, *, once: bool = False, **args: object) -> Command:
        command = new_command(name, args)
        self.client.put(command, once=once)
        return command

    def later(self, ns: float, *, connected: bool = True) -> None:
        self.ns += round(ns)
        self.client.turn(self, connected=connected)

    def names(self) -> list[str]:
        return [name for name, _, _ in self.sent]

    def _tell(self, update) -> None:
        self.told.append((update.command.name, update.state))
        self.replies.append(update.reply)


@pytest.fixture
def line() -> Line:
    return Line()


def test_arguments_that_are_none_are_left_to_the_daemon() -> None:
    assert new_command("scan", {"name": "x", "notes": None}).args == {"name": "x"}


def test_commands_are_sent_in_their_order_each_with_an_id_of_its_own(line: Line) -> None:
    for name in ("pause", "resume", "stop"):
        line.put(name)
    line.later(0)
    assert line.names() == ["pause", "resume", "stop"]
    assert len({request_id for _, request_id, _ in line.sent}) == 3
    assert [state for _, state in line.told] == [SENT] * 3


@pytest.mark.parametrize(("ok", "state"), [(True, DONE), (False, REFUSED)])
def test_a_reply_ends_its_command_and_is_told_once(line: Line, ok: bool, state: CommandState) -> None:
    command = line.put("scan")
    line.later(0)
    reply = Reply(request_id=command.request_id, ok=ok, error="no", result={"path": "/x"}, sent_mono_ns=7)
    line.client.take(reply)
    line.client.take(reply)
    line.later(10 * NS_PER_S)
    assert line.told == [("scan", SENT), ("scan", state)]
    assert line.replies[-1] == reply
    assert line.names() == ["scan"], "what is answered is not sent again"


def test_without_a_reply_it_is_sent_once_more_as_the_same_request_with_the_time_of_the_first(line: Line) -> None:
    command = line.put("goto", position_steps=3)
    line.later(0)
    first_ns = line.ns
    for _ in range(39):
        line.later(100 * NS_PER_MS)
    assert line.sent == [("goto", command.request_id, first_ns)] * 2
    assert line.told == [("goto", SENT)]
    line.later(100 * NS_PER_MS)
    assert line.told == [("goto", SENT), ("goto", NO_ANSWER)]


def test_what_was_sent_is_given_up_in_time_even_when_there_is_no_socket_any_more(line: Line) -> None:
    line.put("goto")
    line.later(0)
    line.ns += round(TIMEOUT_S * NS_PER_S)
    line.client.turn(None)
    assert line.told[-1] == ("goto", NO_ANSWER)


def test_without_a_socket_a_command_is_refused_at_once_and_never_kept(line: Line) -> None:
    for name in ("scan", "stop"):
        line.put(name)
    line.client.turn(None)
    assert line.told == [("scan", NO_DAEMON), ("stop", NO_DAEMON)]
    line.later(0)
    assert line.sent == []


def test_a_silent_daemon_is_sent_nothing_but_stop(line: Line) -> None:
    for name in ("scan", "stop"):
        line.put(name)
    line.later(0, connected=False)
    assert line.names() == ["stop"]
    assert line.told == [("scan", NO_DAEMON), ("stop", SENT)]


def test_a_daemon_that_is_just_connecting_gets_the_command_a_moment_later(line: Line) -> None:
    line.there = False
    line.put("scan")
    line.later(0)
    assert line.client.connecting
    line.there = True
    line.later(CONNECTING_NS / 2)
    assert line.names() == ["scan"]
    assert not line.client.connecting


def test_a_daemon_that_does_not_connect_gets_nothing_later(line: Line) -> None:
    line.there = False
    line.put("scan")
    line.later(0)
    line.later(CONNECTING_NS + 1)
    line.there = True
    line.later(0)
    assert (line.told, line.sent) == ([("scan", NO_DAEMON)], [])


def test_after_a_freeze_of_this_process_only_stop_is_sent(line: Line) -> None:
    for name in ("scan", "stop", "jog"):
        line.put(name)
    line.later(STALE_NS + 1)
    assert line.names() == ["stop"]
    assert line.told == [("scan", STALE), ("stop", SENT), ("jog", STALE)]


def test_late_beats_of_a_held_jog_are_not_sent_so_that_bunched_ones_do_not_move_the_stage_on(line: Line) -> None:
    line.put("jog_hold", direction=1)
    line.ns += STALE_BEAT_NS + 1
    line.put("jog_hold", direction=-1)
    line.later(0)
    assert line.told == [("jog_hold", STALE), ("jog_hold", SENT)]


def test_a_second_click_while_the_first_is_under_way_is_passed_over(line: Line) -> None:
    first = line.put("scan", once=True)
    line.put("scan", once=True)
    line.put("stop")
    line.put("stop")
    line.later(0)
    assert line.names() == ["scan", "stop", "stop"]
    line.client.take(Reply(request_id=first.request_id, ok=True))
    line.put("scan", once=True)
    line.later(0)
    assert line.names() == ["scan", "stop", "stop", "scan"]
