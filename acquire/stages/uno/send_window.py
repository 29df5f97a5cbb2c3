"""The host's half of exactly-once delivery: a send window with go-back-N resends. Pure: time is an argument."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass, field

from acquire.stages.uno.framing import Block

from .wire_format import WINDOW_MAX, AckBody, Cmd, Msg, ReportBody, Result

BYTES_IN_FLIGHT_MAX = 110
"""What the firmware's receive buffer holds, less one byte per block of reserve."""
QUEUE_MAX = 64


@dataclass
class SerialCommand:
    """A command and the future of its answer."""

    kind: int
    body: bytes
    answer: Future[Block] = field(default_factory=Future)
    sequence: int = -1


@dataclass(frozen=True)
class Timing:
    """Waits of the link in seconds."""

    resend_s: float = 0.05
    """First wait for an answer; it grows by half each time, up to ``resend_max_s``."""
    resend_max_s: float = 0.4
    gap_pause_s: float = 0.01
    """Least time between two resends that the firmware asked for."""


class SendWindow:
    """Commands in order, at most ``WINDOW_MAX`` unanswered; go-back-N."""

    def __init__(self, timing: Timing) -> None:
        self._timing = timing
        self._waiting: deque[SerialCommand] = deque()
        self._flying: deque[SerialCommand] = deque()
        self._next = 0
        self._resend_at_s = 0.0
        self._wait_s = timing.resend_s
        self._asked_s = 0.0
        self.resent = 0

    def put(self, command: SerialCommand) -> bool:
        """Queue a command; False when the queue is full."""
        if len(self._waiting) >= QUEUE_MAX:
            return False
        self._waiting.append(command)
        return True

    def holds(self, kind: int) -> bool:
        """True while a command of this kind waits or is unanswered."""
        return any(command.kind == kind for queue in (self._waiting, self._flying) for command in queue)

    @property
    def idle(self) -> bool:
        """Nothing is unanswered."""
        return not self._flying

    @property
    def deadline_s(self) -> float | None:
        """When the next resend is due; None while nothing is unanswered."""
        return self._resend_at_s if self._flying else None

    def due(self, now_s: float) -> list[Block]:
        """Blocks to write now: new ones as the window allows, or all unanswered ones when their time is up."""
        blocks = []
        if self._flying and now_s >= self._resend_at_s:
            self._wait_s = min(self._wait_s * 1.5, self._timing.resend_max_s)
            blocks = self._again(now_s)
        while self._waiting and self._fits(self._waiting[0]):
            command = self._waiting.popleft()
            command.sequence = self._next
            self._next = (self._next + 1) & 0xFF
            if not self._flying:
                self._resend_at_s = now_s + self._wait_s
            self._flying.append(command)
            blocks.append(_block(command))
        return blocks

    def _fits(self, command: SerialCommand) -> bool:
        """Counted from the oldest unanswered command, because the firmware remembers only RESULT_MEMORY results."""
        if not self._flying:
            return True
        in_flight = sum(len(flying.body) + 10 for flying in self._flying)
        span = (self._next - self._flying[0].sequence) & 0xFF
        return span < WINDOW_MAX and in_flight + len(command.body) + 10 <= BYTES_IN_FLIGHT_MAX

    def _again(self, now_s: float) -> list[Block]:
        self._resend_at_s = now_s + self._wait_s
        self.resent += len(self._flying)
        return [_block(command) for command in self._flying]

    def take(self, block: Block, now_s: float) -> list[Block]:
        """An answer came: completes its command; returns blocks to write again if the firmware asks for them."""
        if block.kind == Msg.ACK:
            ack = AckBody.unpack(block.body)
            if ack.result in (Result.BAD_BLOCK, Result.GAP):
                return self._go_back(now_s)
        elif block.kind == Msg.REPORT:
            expected = ReportBody.unpack(block.body).expected_sequence
            if (expected - block.sequence) & 0xFF not in range(1, WINDOW_MAX + 1):
                return []  # an unsolicited report
        self._complete(block, now_s)
        return []

    def _go_back(self, now_s: float) -> list[Block]:
        if not self._flying or now_s < self._asked_s + self._timing.gap_pause_s:
            return []
        self._asked_s = now_s
        return self._again(now_s)

    def _complete(self, block: Block, now_s: float) -> None:
        for command in self._flying:
            if command.sequence == block.sequence and _answers(block.kind, command.kind):
                self._flying.remove(command)
                self._wait_s = self._timing.resend_s
                self._resend_at_s = now_s + self._wait_s
                command.answer.set_result(block)
                return

    def reset(self) -> list[SerialCommand]:
        """Begin a new session: returns everything unanswered; sequence numbers start again at 0."""
        lost = [*self._flying, *self._waiting]
        self._flying.clear()
        self._waiting.clear()
        self._next = 0
        self._wait_s = self._timing.resend_s
        return lost


def _answers(reply: int, command: int) -> bool:
    """An unsolicited report has sequence 0 and must not count as the answer to another command."""
    if reply == Msg.REPORT:
        return command in (Cmd.STATUS, Cmd.EVENTS)
    return reply == Msg.ACK or (reply == Msg.DIAGNOSIS and command == Cmd.DIAGNOSE)


def _block(command: SerialCommand) -> Block:
    return Block(command.sequence, command.kind, command.body)
