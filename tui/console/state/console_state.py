"""What this console knows: the rig as last reported, the next scan, log, faults, STOP, open answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, assert_never

from acquire.contract.messaging.messages import ResultEnd, Status
from acquire.contract.permissions import accepted_words, needs_control
from tui.console.link.messages import (
    CommandAnswered,
    LinkChanged,
    MapsArrived,
    PageKnown,
    PictureArrived,
    ProgressArrived,
    ResultsOnDisk,
    StatusArrived,
    Update,
)
from tui.console.link.rig_view import RigView
from tui.console.state.fault_log import FaultLog
from tui.console.state.next_scan import NextScan
from tui.console.state.session_log import SessionLog, local_time
from tui.console.state.stop_state import StopState
from tui.text.status_text import newest_fault

OnAnswer = Callable[[CommandAnswered], Any]


class ConsoleState:
    """Takes the updates of the link; the screens read it."""

    def __init__(self, me: str, next_scan: NextScan, clock: Callable[[], str] = local_time) -> None:
        """``me`` is this console's name on the rig; ``clock`` gives the time of day for the log."""
        self.view = RigView(me=me)
        self.next_scan = next_scan
        self.log = SessionLog(clock)
        self.faults = FaultLog()
        self.stop = StopState(lambda: self.log.say("STOP sent; waiting until the rig confirms it", "warning"))
        self._on_answer: dict[str, OnAnswer] = {}

    def expect_answer(self, request_id: str, on_answer: OnAnswer) -> None:
        """Have ``on_answer`` called with the answer to a request, which then is not logged."""
        self._on_answer[request_id] = on_answer

    def take(self, update: Update) -> None:
        """One update of the link."""
        match update:
            case StatusArrived():
                self._take_status(update.status)
            case ProgressArrived():
                self.log.take_progress(update.progress)
                self.view = replace(self.view, progress=update.progress)
            case PictureArrived():
                self.view = replace(self.view, picture=update.picture)
            case MapsArrived():
                self.view = replace(self.view, maps=update.maps)
            case ResultsOnDisk():
                self._take_results(update.result)
            case LinkChanged():
                self._take_link(update.connected, update.detail)
            case CommandAnswered():
                self._take_answer(update)
            case PageKnown():
                self.view = replace(self.view, url=update.url)
            case _:
                assert_never(update)

    def _take_status(self, status: Status) -> None:
        self.faults.take(status.faults)
        self.log.take_status(self.view.status, status)
        stopped = self.stop.take_status(status)
        if stopped:
            self.log.say(stopped)
        self.view = replace(self.view, status=status, stop_words=self.stop.words)

    def _take_results(self, result: ResultEnd) -> None:
        if result.cloud_path:
            self.log.say(f"{result.points} points in {result.cloud_path} ({result.seconds:.2f} s after the last frame)")
        elif result.message:
            self.log.say(f"no cloud: {result.message}", "warning")

    def _take_link(self, connected: bool, detail: str) -> None:
        if connected:
            self.log.say(f"connected to the rig in {detail}")
        else:
            self.log.say(f"not connected - retrying: {detail}", "warning")
        self.view = replace(self.view, connected=connected)

    def _take_answer(self, answer: CommandAnswered) -> None:
        if answer.name == "stop":
            self.stop.answered(ok=answer.ok, at_mono_ns=answer.at_mono_ns)
            self.view = replace(self.view, stop_words=self.stop.words)
        on_answer = self._on_answer.pop(answer.request_id, None)
        if on_answer is not None:
            on_answer(answer)
        elif not answer.ok:
            self.log.say(f"{answer.name}: {answer.detail}", "error")
        elif answer.name != "stop":
            self.log.say(f"{answer.name}: {answer.detail or accepted_words(answer.name)}")

    # ---- why not now ----

    @property
    def has_control(self) -> bool:
        """True if this console holds control (and does not only find it free)."""
        status = self.view.status
        return status is not None and bool(status.control) and status.control == self.view.me

    def why_no_command(self, *, changes: bool) -> str:
        """Why no command can be sent now (``changes``: none that changes the rig); empty if it can."""
        if not self.view.connected or self.view.status is None:
            return "not connected"
        if changes and not self.view.in_control:
            return f"{self.view.status.control} holds control: T takes it"
        return ""

    def why_not(self, action: str) -> str:
        """Why an action that every screen has cannot be done now; empty if it can."""
        status = self.view.status
        if action == "acknowledge" and (status is None or newest_fault(status.faults) is None):
            return "there is no fault"
        return self.why_no_command(changes=needs_control(action)) if action in ("acknowledge", "control") else ""
