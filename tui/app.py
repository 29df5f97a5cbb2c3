"""The console: a client of the daemon that shows the rig and steers it; its end never touches a sweep."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from textual import events
from textual.app import App
from textual.binding import Binding
from textual.message import Message

from acquire.contract.messages import ResultProgress, Status
from acquire.contract.states import HoldReason, Outcome, State
from tui.messages import (
    CommandAnswered,
    LinkChanged,
    Note,
    PageKnown,
    ProgressArrived,
    ResultsOnDisk,
    StatusArrived,
)
from tui.screens.dialogs import AskName, ConfirmQuit, Help
from tui.screens.rig import RigScreen
from tui.widgets.log_pane import local_time
from tui.words import MOVING_STATES, is_running, newest_fault, outcome_line, position_words, scan_name, state_words

STOP_KEY = "space"


class Link(Protocol):
    """What the console needs of its connection."""

    def start(self) -> None:
        """Begin to listen."""

    def close(self) -> None:
        """End."""

    def send(self, name: str, /, **args: Any) -> None:
        """Send a command without waiting."""


LinkMaker = Callable[[Callable[[Message], Any]], Link]
"""Makes a connection that posts to the given function."""


class ConsoleApp(App[None]):
    """One screen over one rig."""

    TITLE = "sweepscope"
    ENABLE_COMMAND_PALETTE = False
    BINDINGS = [
        Binding("s", "start", "start"),
        Binding("p", "pause", "pause"),
        Binding("r", "resume", "resume"),
        Binding("a", "acknowledge", "acknowledge"),
        Binding("q", "quit", "quit"),
        Binding("question_mark", "help", "help"),
    ]

    def __init__(
        self,
        make_link: LinkMaker,
        *,
        ascii_only: bool = False,
        owns_rig: bool = False,
        clock: Callable[[], str] = local_time,
        on_started: Callable[[ConsoleApp], None] | None = None,
    ) -> None:
        """``owns_rig``: the services end with this program, so leaving during a sweep is asked about."""
        super().__init__()
        self._link = make_link(self.post_message)
        self._owns_rig = owns_rig
        self._on_started = on_started
        self._rig = RigScreen(clock, ascii_only=ascii_only)
        self.status: Status | None = None
        self.progress: ResultProgress | None = None
        self.connected = False
        self.url = ""
        self._stop_words = ""
        self._stop_answered_ns: int | None = None
        self._faults_said: set[tuple[str, int]] = set()

    # ---- life ----

    def on_mount(self) -> None:
        """Show the screen, then listen."""
        self.push_screen(self._rig)
        for number in (signal.SIGTERM, signal.SIGHUP):
            self._leave_on(number)
        self._link.start()
        if self._on_started is not None:
            self._on_started(self)

    def _leave_on(self, number: signal.Signals) -> None:
        try:
            asyncio.get_running_loop().add_signal_handler(number, self.exit)
        except (RuntimeError, ValueError):  # not the main thread: somebody else minds the signals
            return

    def on_unmount(self) -> None:
        """End the input thread."""
        self._link.close()

    def say(self, text: str, level: str = "info") -> None:
        """A line for the log."""
        self._rig.log_pane.say(text, level)

    def _refresh(self) -> None:
        self._rig.show(self.status, self.progress, connected=self.connected, url=self.url, stop_words=self._stop_words)

    # ---- news ----

    def on_status_arrived(self, message: StatusArrived) -> None:
        """The newest state."""
        before, self.status = self.status, message.status
        self._say_changes(before, message.status)
        self._judge_stop(message.status)
        self._refresh()

    def on_progress_arrived(self, message: ProgressArrived) -> None:
        """The worker's news."""
        said = self.progress.message if self.progress else ""
        if message.progress.message not in ("", said):
            self.say(f"worker: {message.progress.message}", "warning")
        self.progress = message.progress
        self._refresh()

    def on_results_on_disk(self, message: ResultsOnDisk) -> None:
        """A cloud is there."""
        result = message.result
        if result.cloud_path:
            self.say(f"{result.points} points in {result.cloud_path} ({result.seconds:.2f} s after the last frame)")
        elif result.message:
            self.say(f"no cloud: {result.message}", "warning")

    def on_link_changed(self, message: LinkChanged) -> None:
        """The daemon is heard, or not."""
        self.connected = message.connected
        if message.connected:
            self.say(f"connected to the rig in {message.detail}")
        else:
            self.say(f"not connected - retrying: {message.detail}", "warning")
        self._refresh()

    def on_command_answered(self, message: CommandAnswered) -> None:
        """What became of a command."""
        if message.name == "stop":
            self._stop_answered_ns = message.at_mono_ns
        if not message.ok:
            if message.name == "stop":
                self._stop_words = "STOP NOT CONFIRMED"
            self.say(f"{message.name}: {message.detail}", "error")
        elif message.name != "stop":
            self.say(f"{message.name}: {message.detail or 'done'}")
        self._refresh()

    def on_page_known(self, message: PageKnown) -> None:
        """The address of the page."""
        self.url = message.url
        self._refresh()

    def on_note(self, message: Note) -> None:
        """A line from elsewhere in this process."""
        self.say(message.text, message.level)

    def _say_changes(self, before: Status | None, now: Status) -> None:
        if before is None or (before.state, before.hold_reason) != (now.state, now.hold_reason):
            self.say(state_words(now))
        if now.message and (before is None or before.message != now.message) and not _said_otherwise(now):
            self.say(now.message)
        for fault in now.faults:
            if (fault.code, fault.at_mono_ns) not in self._faults_said:
                self._faults_said.add((fault.code, fault.at_mono_ns))
                self.say(f"{fault.code} {fault.happened}. Safe: {fault.safe}. To do: {fault.to_do}", "error")
        ended = now.outcome not in ("", Outcome.RUNNING) and not is_running(now)
        if ended and before is not None and (before.outcome != now.outcome or is_running(before)):
            self.say(outcome_line(now), "info" if now.outcome == Outcome.COMPLETE else "warning")

    def _judge_stop(self, status: Status) -> None:
        """STOP is confirmed by the rig's state alone, as it was said after the daemon had taken the command."""
        if not self._stop_words or self._stop_answered_ns is None or status.sent_mono_ns < self._stop_answered_ns:
            return
        if status.state == State.FINISHING:
            self._stop_words = "STOP taken: saving what was taken"
        elif status.state not in MOVING_STATES:
            self._stop_words = ""
            self.say(f"stopped at {position_words(status)}")

    # ---- keys ----

    async def on_event(self, event: events.Event) -> None:
        """STOP before anything else sees the key: Textual's priority bindings give way to a field that takes text."""
        if isinstance(event, events.Key) and event.key == STOP_KEY and not event.is_forwarded:
            self.action_stop()
            return
        await super().on_event(event)

    def action_stop(self) -> None:
        """End all motion."""
        self._stop_words, self._stop_answered_ns = "STOP sent", None
        self._link.send("stop")
        self.say("STOP sent; waiting for the rig's own word", "warning")
        self._refresh()

    def action_start(self) -> None:
        """Ask for a name and start a sweep."""
        if not self._can("start", {State.IDLE}):
            return
        assert self.status is not None
        previous = scan_name(self.status).partition("-")[2]

        def start(name: str | None) -> None:
            if name:
                self._link.send("scan", name=name)

        self.push_screen(AskName(previous or "sweep"), start)

    def action_pause(self) -> None:
        """Hold the sweep."""
        if self._can("pause", {State.SWEEPING, State.HOLDING}):
            self._link.send("pause")

    def action_resume(self) -> None:
        """Go on."""
        if not self._can("resume", {State.HOLDING}):
            return
        if self.status is not None and self.status.hold_reason != HoldReason.PAUSED:
            self.say(f"resume: the sweep holds by itself ({self.status.hold_reason}) and goes on by itself", "warning")
            return
        self._link.send("resume")

    def action_acknowledge(self) -> None:
        """Take the newest fault off the banner."""
        fault = newest_fault(self.status.faults) if self.status else None
        if fault is not None:
            self._link.send("acknowledge", code=fault.code)

    def action_help(self) -> None:
        """Show the keys."""
        self.push_screen(Help())

    async def action_quit(self) -> None:
        """Leave; asked first if a sweep would end with this program."""
        if self._owns_rig and is_running(self.status) and self.connected:
            if not isinstance(self.screen, ConfirmQuit):
                self.push_screen(ConfirmQuit(), lambda leave: self.exit() if leave else None)
            return
        self.exit()

    def _can(self, what: str, states: set[State]) -> bool:
        if isinstance(self.screen, (AskName, ConfirmQuit, Help)):
            return False
        if self.status is None or not self.connected:
            self.say(f"{what}: not connected", "warning")
            return False
        if self.status.state not in states:
            self.say(f"{what}: not while the rig is {state_words(self.status)}", "warning")
            return False
        return True


def _said_otherwise(status: Status) -> bool:
    """True if the message only repeats a fault or the outcome, which get lines of their own."""
    outcome = outcome_line(status)
    codes = tuple(f"{fault.code} " for fault in status.faults)
    return status.message.startswith(codes) or bool(outcome and status.message.startswith(outcome))


def run_console(
    *,
    run_dir: Path | None = None,
    ascii_only: bool = False,
    owns_rig: bool = False,
    command_timeout_s: float = 5.0,
    on_started: Callable[[ConsoleApp], None] | None = None,
) -> int:
    """Run the console on this terminal until the operator leaves; returns the exit status."""
    from tui.link import RigLink  # noqa: PLC0415 - tests run the console without sockets
    from tui.terminal import prepare_terminal  # noqa: PLC0415

    def make_link(post: Callable[[Message], Any]) -> Link:
        return RigLink(post, run_dir=run_dir, command_timeout_s=command_timeout_s)

    prepare_terminal()
    app = ConsoleApp(make_link, ascii_only=ascii_only, owns_rig=owns_rig, on_started=on_started)
    app.run(mouse=False)
    if app.return_code:
        print("the console ended by an error; if the terminal looks odd, type: reset", file=sys.stderr)
    return app.return_code or 0
