"""The log of this session: every line with its time, bounded; what new states of rig and worker add to it."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime

from acquire.contract.faults import headline
from acquire.contract.messaging.messages import ResultProgress, Status
from acquire.contract.states import Outcome
from tui.text.status_text import is_running, outcome_line, state_words

MAX_LINES = 2000


def local_time() -> str:
    """The time of day as the log shows it."""
    return datetime.now().astimezone().strftime("%H:%M:%S")


@dataclass(frozen=True)
class LogLine:
    """One line of the log."""

    at: str
    """Local time of day."""
    level: str
    """``info``, ``warning`` or ``error``."""
    text: str


class SessionLog:
    """Keeps the newest lines. Each fault, each end of a scan and each message of the worker is logged once."""

    def __init__(self, clock: Callable[[], str] = local_time) -> None:
        self.lines: deque[LogLine] = deque(maxlen=MAX_LINES)
        self.count = 0
        """Lines logged so far, including those that were dropped."""
        self._clock = clock
        self._faults: set[tuple[str, int]] = set()
        self._worker: tuple[str, set[str]] = ("", set())

    def say(self, text: str, level: str = "info") -> bool:
        """Add a line; False for one that repeats the last line, which is left out."""
        if self.lines and self.lines[-1].text == text:
            return False
        self.lines.append(LogLine(self._clock(), level, text))
        self.count += 1
        return True

    def take_status(self, before: Status | None, now: Status) -> None:
        """Log what the change from ``before`` to ``now`` means."""
        for text, level in (*_state_lines(before, now), *self._new_faults(now), *_end_lines(before, now)):
            self.say(text, level)

    def take_progress(self, progress: ResultProgress) -> None:
        """Log the worker's message once per scan, whatever its numbers: a busy worker repeats it with each frame."""
        if self._worker[0] != progress.scan_uid:
            self._worker = (progress.scan_uid, set())
        kind = re.sub(r"\d+", "#", progress.message)
        if kind and kind not in self._worker[1]:
            self._worker[1].add(kind)
            level = "error" if progress.failed else "warning" if progress.scan_uid else "info"
            self.say(f"worker: {progress.message}", level)

    def _new_faults(self, now: Status) -> Iterator[tuple[str, str]]:
        for fault in now.faults:
            if (fault.code, fault.at_mono_ns) not in self._faults:
                self._faults.add((fault.code, fault.at_mono_ns))
                yield f"{headline(fault)}. Safe: {fault.safe}. To do: {fault.to_do}", "error"


def _state_lines(before: Status | None, now: Status) -> Iterator[tuple[str, str]]:
    if before is None or (before.state, before.hold_reason) != (now.state, now.hold_reason):
        yield state_words(now), "info"
    if before is not None and before.control != now.control:
        yield f"{now.control} holds control now" if now.control else "control is free now", "info"
    if now.message and (before is None or before.message != now.message) and not _is_repeated(now):
        yield now.message, "info"


def _end_lines(before: Status | None, now: Status) -> Iterator[tuple[str, str]]:
    ended = now.outcome not in ("", Outcome.RUNNING) and not is_running(now)
    if ended and before is not None and (before.outcome != now.outcome or is_running(before)):
        yield outcome_line(now), "info" if now.outcome == Outcome.COMPLETE else "warning"


def _is_repeated(status: Status) -> bool:
    """True if the message only repeats a fault or the outcome, which have lines of their own."""
    outcome = outcome_line(status)
    codes = tuple(f"{fault.code} " for fault in status.faults)
    return status.message.startswith(codes) or bool(outcome and status.message.startswith(outcome))
