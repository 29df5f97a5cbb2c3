"""The scan screen: the picture, the stage, the light, and a sweep from its plan to its end."""

from __future__ import annotations

from dataclasses import replace

from textual.app import ComposeResult
from textual.binding import Binding

from acquire.contract.states import HoldReason, State
from tui.draft import Draft
from tui.screens.base import RigScreenBase
from tui.screens.dialogs import Field, Form, valid_name
from tui.view import RigView
from tui.widgets.log_tail import LogTail
from tui.widgets.panes import StatePane, SweepPane
from tui.words import scan_name, state_words


class ScanScreen(RigScreenBase):
    """Prepare a sweep and watch it."""

    NAME = "scan"
    SHOWS_LOG = True
    WANTS_PICTURES = True
    CHANGES = frozenset({"start", "pause", "resume"})
    BINDINGS = [
        Binding("s", "start", "start", id="scan.start"),
        Binding("p", "pause", "pause", id="scan.pause"),
        Binding("r", "resume", "resume", id="scan.resume"),
    ]

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(ascii_only=ascii_only)
        self._state = StatePane(ascii_only=ascii_only)
        self._sweep = SweepPane(ascii_only=ascii_only)
        self._log = LogTail(ascii_only=ascii_only)

    def body(self) -> ComposeResult:
        """State, sweep, log."""
        yield self._state
        yield self._sweep
        yield self._log

    def show(self, view: RigView) -> None:
        """Hand the newest values to the panes."""
        self._state.status, self._state.connected, self._state.stop_words = view.status, view.connected, ""
        self._sweep.status, self._sweep.progress, self._sweep.connected = view.status, view.progress, view.connected
        self._state.changed()
        self._sweep.changed()
        self._log.show(self.shell.logbook)

    def why_not(self, action: str) -> str:
        """The rig's state decides."""
        status = self.view.status
        if status is None:
            return "nothing is known of the rig"
        wanted = {
            "start": {State.IDLE, State.PREVIEW},
            "pause": {State.SWEEPING, State.HOLDING},
            "resume": {State.HOLDING},
        }
        if action in wanted and status.state not in wanted[action]:
            return f"not while the rig is {state_words(status)}"
        if action == "resume" and status.hold_reason != HoldReason.PAUSED:
            return f"the sweep holds by itself ({status.hold_reason}) and goes on by itself"
        return ""

    def action_start(self) -> None:
        """Ask for a name and start a sweep."""
        draft, status = self.shell.draft, self.view.status
        previous = scan_name(status).partition("-")[2] if status is not None else ""
        name = draft.name if draft.name != Draft.name or not previous else previous

        def start(name: str | None) -> None:
            if name is not None:
                self.shell.draft = replace(self.shell.draft, name=name)
                self.send("scan", **self.shell.draft.scan_args())

        form = Form("start a sweep", [Field("name", "name", name)], _parse_name, done="starts the sweep")
        self.shell.push_screen(form, start)

    def action_pause(self) -> None:
        """Hold the sweep."""
        self.send("pause")

    def action_resume(self) -> None:
        """Go on."""
        self.send("resume")


def _parse_name(texts: dict[str, str]) -> str:
    if not valid_name(texts["name"]):
        raise ValueError("that is no name: use 1 to 64 letters, digits, - _ . without spaces")
    return texts["name"]
