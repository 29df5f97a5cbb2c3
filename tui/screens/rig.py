"""The rig screen: lays the panes out for the terminal's size and hands them the newest values."""

from __future__ import annotations

from collections.abc import Callable

from textual.app import ComposeResult
from textual.containers import Container
from textual.events import Resize
from textual.screen import Screen
from textual.widgets import Static

from acquire.contract.messages import ResultProgress, Status
from tui.widgets.log_pane import LogPane
from tui.widgets.panes import FaultBanner, KeyLine, StatePane, SweepPane, TitleLine

LEAST_WIDTH, LEAST_HEIGHT = 60, 20
WIDE = 140
"""From this width on, state and sweep stand side by side."""


class RigScreen(Screen[None]):
    """State, sweep, faults and log on one screen."""

    DEFAULT_CSS = """
    RigScreen #panes { height: auto; layout: vertical; }
    RigScreen.wide #panes { layout: horizontal; }
    RigScreen.wide #panes > * { width: 1fr; height: 8; }
    RigScreen #small { display: none; }
    RigScreen.small #small { display: block; }
    RigScreen.small #panes, RigScreen.small #log { display: none; }
    """

    def __init__(self, clock: Callable[[], str], *, ascii_only: bool = False) -> None:
        super().__init__()
        self._title = TitleLine(ascii_only=ascii_only)
        self._state = StatePane(ascii_only=ascii_only)
        self._sweep = SweepPane(ascii_only=ascii_only)
        self._fault = FaultBanner(ascii_only=ascii_only)
        self._keys = KeyLine(ascii_only=ascii_only)
        self.log_pane = LogPane(clock)

    def compose(self) -> ComposeResult:
        """All panes; styles decide which are seen."""
        yield self._title
        yield Container(self._state, self._sweep, id="panes")
        yield Static(f"this terminal is smaller than {LEAST_WIDTH} x {LEAST_HEIGHT}; SPACE = STOP works", id="small")
        yield self._fault
        yield self.log_pane
        yield self._keys

    def on_resize(self, event: Resize) -> None:
        """Choose the layout."""
        self.set_class(event.size.width >= WIDE, "wide")
        self.set_class(event.size.width < LEAST_WIDTH or event.size.height < LEAST_HEIGHT, "small")

    def show(
        self, status: Status | None, progress: ResultProgress | None, *, connected: bool, url: str, stop_words: str
    ) -> None:
        """Hand the newest values to the panes."""
        self._title.connected, self._title.url = connected, url
        if status is not None:
            lamp = "on" if status.lamp_on else "off"
            self._title.devices = f"{status.stage_kind} stage  {status.camera_kind} camera  lamp {lamp}"
            self._fault.show(status.faults)
        self._state.status, self._state.connected, self._state.stop_words = status, connected, stop_words
        self._sweep.status, self._sweep.progress, self._sweep.connected = status, progress, connected
        self._keys.status, self._keys.connected = status, connected
        for pane in (self._title, self._state, self._sweep, self._keys):
            pane.changed()
