"""What a new state of rig or worker means as lines for the log; says each fault, each end and each trouble once."""

from __future__ import annotations

import re
from collections.abc import Iterator

from acquire.contract.messaging.messages import ResultProgress, Status
from acquire.contract.states import Outcome
from tui.text.status_text import is_running, outcome_line, state_words

Said = tuple[str, str]
"""Text and level."""


class Narrator:
    """Remembers which faults were said, and what the worker said of the scan."""

    def __init__(self) -> None:
        self._faults: set[tuple[str, int]] = set()
        self._worker: tuple[str, set[str]] = ("", set())

    def said(self, before: Status | None, now: Status) -> list[Said]:
        """The lines that the change from ``before`` to ``now`` is worth."""
        return [*_state(before, now), *self._new_faults(now), *_end(before, now)]

    def worker_said(self, progress: ResultProgress) -> list[Said]:
        """The worker's words, once for each scan, whatever numbers are in them: a busy one says them in each frame."""
        if self._worker[0] != progress.scan_uid:
            self._worker = (progress.scan_uid, set())
        kind = re.sub(r"\d+", "#", progress.message)
        if not kind or kind in self._worker[1]:
            return []
        self._worker[1].add(kind)
        return [(f"worker: {progress.message}", "warning" if progress.scan_uid else "info")]

    def _new_faults(self, now: Status) -> Iterator[Said]:
        for fault in now.faults:
            if (fault.code, fault.at_mono_ns) not in self._faults:
                self._faults.add((fault.code, fault.at_mono_ns))
                yield f"{fault.code} {fault.happened}. Safe: {fault.safe}. To do: {fault.to_do}", "error"


def _state(before: Status | None, now: Status) -> Iterator[Said]:
    if before is None or (before.state, before.hold_reason) != (now.state, now.hold_reason):
        yield state_words(now), "info"
    if before is not None and before.control != now.control:
        yield f"{now.control} holds control now" if now.control else "nobody holds control now", "info"
    if now.message and (before is None or before.message != now.message) and not _said_otherwise(now):
        yield now.message, "info"


def _end(before: Status | None, now: Status) -> Iterator[Said]:
    ended = now.outcome not in ("", Outcome.RUNNING) and not is_running(now)
    if ended and before is not None and (before.outcome != now.outcome or is_running(before)):
        yield outcome_line(now), "info" if now.outcome == Outcome.COMPLETE else "warning"


def _said_otherwise(status: Status) -> bool:
    """True if the message only repeats a fault or the outcome, which get lines of their own."""
    outcome = outcome_line(status)
    codes = tuple(f"{fault.code} " for fault in status.faults)
    return status.message.startswith(codes) or bool(outcome and status.message.startswith(outcome))
