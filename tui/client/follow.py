"""Follows one scan on the status lane until it has ended; gives up when no status comes any more."""

from __future__ import annotations

import time
from collections.abc import Callable

from acquire.contract.errors import EXIT_FAILED, EXIT_INCOMPLETE, NoServiceError, SweepscopeError
from acquire.contract.messaging.messages import ResultProgress, Status
from acquire.contract.states import Outcome
from tui.client.rig_client import RigClient
from tui.text.status_text import is_running, progress_line

SILENCE_S = 10.0
SAY_EVERY_S = 5.0


class ProgressPrinter:
    """Says a scan's progress at most every few seconds, and at once when the state changes."""

    def __init__(self, say: Callable[[str], None], every_s: float = SAY_EVERY_S) -> None:
        self.progress: Callable[[], ResultProgress | None] = lambda: None
        self._say = say
        self._every_s = every_s
        self._said_at_s = float("-inf")
        self._state = ""

    def take(self, status: Status) -> None:
        """Say a line if there is reason to."""
        now_s = time.monotonic()
        if status.state == self._state and now_s - self._said_at_s < self._every_s:
            return
        self._state, self._said_at_s = status.state, now_s
        self._say(progress_line(status, self.progress()))


def has_ended(status: Status, scan_uid: str) -> bool:
    """True once the daemon says how the scan ended and no longer works on it."""
    return status.scan_uid == scan_uid and status.outcome not in ("", Outcome.RUNNING) and not is_running(status)


def follow_scan(
    client: RigClient, scan_uid: str, on_status: Callable[[Status], None], silence_s: float = SILENCE_S
) -> Status:
    """The status with which the scan ``scan_uid`` ended.

    Raises:
        NoServiceError: no status came for ``silence_s``.
        SweepscopeError: the daemon was started again, so that the scan is interrupted.
    """
    seen = False
    while True:
        status = client.newest_status(silence_s)
        if status is None:
            raise NoServiceError(
                f"the rig daemon fell silent for {silence_s:g} s: committed frames are in the file; "
                "see 'sweepscope status'"
            )
        if status.scan_uid != scan_uid:
            if seen:
                raise SweepscopeError("the rig daemon was started again in mid-sweep: what was committed is safe")
            continue
        seen = True
        on_status(status)
        if has_ended(status, scan_uid):
            return status


def exit_status_of(status: Status) -> int:
    """0 for a complete scan, 4 for one that lacks frames, 1 for one that failed."""
    if status.outcome == Outcome.FAILED:
        return EXIT_FAILED
    complete = status.outcome == Outcome.COMPLETE and status.committed == status.expected and not status.missing
    return 0 if complete else EXIT_INCOMPLETE
