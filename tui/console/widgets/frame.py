"""The frame of every screen: header with state and tabs, fault banner, the newest line of the log, the keys."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from rich.text import Text

from acquire.contract.faults import headline
from acquire.contract.messaging.messages import FaultReport
from acquire.contract.states import UNKNOWN_SIGN, State, sign_of
from tui.console.keys import STOP_KEY
from tui.console.link.rig_view import RigView
from tui.console.screen_table import SCREENS
from tui.console.state.session_log import LogLine
from tui.console.widgets.lines import Lines, clickable
from tui.text.status_text import newest_fault, state_words
from tui.text.width import shorten

NOT_CONNECTED = "not connected - retrying"
LEVEL_STYLES = {"info": "", "warning": "yellow", "error": "bold red"}
STATE_STYLES: dict[str, str] = {
    State.IDLE: "bold green",
    **dict.fromkeys((State.HOMING, State.MOVING, State.PREVIEW, State.ARMED), "bold cyan"),
    **dict.fromkeys((State.SWEEPING, State.FINISHING), "bold #4aa3ff"),
    State.FAULT: "bold red",
}
"""All other states look like a warning."""


class Offer(NamedTuple):
    """An action that can be done now."""

    key: str
    words: str
    action: str
    """With its namespace, for the mouse."""

    @property
    def cells(self) -> int:
        """Width of ``<key> <words>``."""
        return len(self.key) + len(self.words) + 1


class Header(Lines[RigView]):
    """State and devices; the screens; the address of the page while there is one."""

    DEFAULT_CSS = """
    Header { height: 2; background: $panel; padding: 0 1; }
    Header.page { height: 3; }
    """

    def __init__(self, screen_name: str, *, read_only: bool) -> None:
        super().__init__(RigView())
        self._screen_name, self._read_only = screen_name, read_only

    def show(self, value: RigView) -> None:
        """Take the newest values."""
        self.set_class(bool(value.url), "page")
        super().show(value)

    def text_for(self, width: int) -> Text:
        """Two or three lines."""
        text = self._state_line(width)
        text.append("\n").append_text(self._tabs_line(width))
        if self.shown.url:
            page = f"page  {self.shown.url}"
            text.append("\n" + (page if len(page) <= width else self.shown.url), style="dim")
        return text

    def _state_line(self, width: int) -> Text:
        view, status = self.shown, self.shown.status
        text = Text("sweepscope  ", style="bold", no_wrap=True)
        if view.connected and status is not None:
            style = STATE_STYLES.get(status.state, "bold yellow")
            text.append(f"{sign_of(status.state).glyph} {state_words(status)}", style=style)
        else:
            text.append(f"{UNKNOWN_SIGN.glyph} {NOT_CONNECTED.upper()}", style="bold yellow")
            if status is not None:
                text.append(f"  last known: {state_words(status)}", style="not bold dim")
        if view.stop_words:
            text.append("  ").append(f" {view.stop_words} ", style="bold reverse")
        right = ""
        if status is not None:
            lamp = "on" if status.lamp_on else "off"
            right = f"{status.stage_kind} stage  {status.camera_kind} camera  lamp {lamp}"
        gap = width - text.cell_len - len(right)
        return text.append(" " * gap + right, style="not bold") if gap >= 2 else text

    def _tabs_line(self, width: int) -> Text:
        text = Text(no_wrap=True)
        for number, entry in enumerate(SCREENS, 1):
            begin = len(text)
            text.append(f" {number} {entry.name} ", "bold reverse" if entry.name == self._screen_name else "dim")
            text.stylize(clickable(f"app.go('{entry.name}')"), begin)
        right = self._control_words()
        gap = width - text.cell_len - len(right)
        if gap < 1:  # the holder of control matters more than the tabs, whose numbers stay in view
            right = shorten(right, width // 2)
            text.truncate(max(0, width - len(right) - 1), overflow="ellipsis")
            gap = width - text.cell_len - len(right)
        style = "bold yellow" if not self.shown.in_control else ""
        return text.append(" " * max(0, gap)).append(right, style=style)

    def _control_words(self) -> str:
        status = self.shown.status
        watching = "read-only" if self._read_only else ""
        if status is None or not status.control:
            return watching
        holder = "you" if status.control == self.shown.me else status.control
        return f"{watching}  control: {holder}".strip()


class FaultBanner(Lines[Sequence[FaultReport]]):
    """The newest fault until it is acknowledged: what happened, what is safe, what to do."""

    DEFAULT_CSS = """
    FaultBanner { height: 3; background: $error; color: $text; padding: 0 1; display: none; }
    FaultBanner.visible { display: block; }
    """

    def show(self, value: Sequence[FaultReport]) -> None:
        """Show the newest fault that is not acknowledged, or disappear."""
        self.set_class(newest_fault(value) is not None, "visible")
        super().show(value)

    def text_for(self, width: int) -> Text:
        """Three lines."""
        fault = newest_fault(self.shown)
        if fault is None:
            return Text()
        waiting = sum(not fault.acknowledged for fault in self.shown)
        more = f" (and {waiting - 1} more)" if waiting > 1 else ""
        text = Text(no_wrap=True)
        text.append(shorten(f"✖ FAULT {headline(fault)}{more}", width), style="bold")
        text.append("\n" + shorten(f"  safe:  {fault.safe}", width))
        return text.append("\n" + shorten(f"  to do: {fault.to_do}", width - 27) + "  (a acknowledges, 5 all)")


class LogLastLine(Lines[LogLine | None]):
    """The newest line of the log, for screens that do not show the log."""

    DEFAULT_CSS = "LogLastLine { height: 1; padding: 0 1; dock: bottom; margin-bottom: 2; }"

    def text_for(self, width: int) -> Text:
        """One line."""
        if self.shown is None:
            return Text()
        return Text(shorten(f"{self.shown.at} {self.shown.text}", width), LEVEL_STYLES[self.shown.level], no_wrap=True)


class KeyLine(Lines[Sequence[Offer]]):
    """The keys that do something now; help and STOP are there at any width."""

    DEFAULT_CSS = "KeyLine { dock: bottom; height: 2; background: $panel; padding: 0 1; }"

    @property
    def _stop_words(self) -> str:
        means_stop = getattr(self.app, "means_stop", None)
        return "SPACE = STOP" if means_stop is None or means_stop(STOP_KEY) else "CTRL+X = STOP"

    def text_for(self, width: int) -> Text:
        """Two lines; the second ends with what is pinned, and before it how many keys found no room."""
        stop = self._stop_words
        pinned = len("? help   ") + len(stop)
        first, rest = _fitting(self.shown, width)
        second, rest = _fitting(rest, width - pinned - 12)
        more = f"+{len(rest)}  " if rest else ""
        text = _offers_line(first).append("\n").append_text(_offers_line(second))
        used = sum(offer.cells + 2 for offer in second)
        text.append(" " * max(1, width - used - len(more) - pinned) + more, style="dim")
        return text.append("? help", style="bold").append("   ").append(stop, style="bold red")


def _fitting(offers: Sequence[Offer], width: int) -> tuple[Sequence[Offer], Sequence[Offer]]:
    """The offers that fit into a line, and the rest."""
    used = 0
    for number, offer in enumerate(offers):
        if used + offer.cells > width:
            return offers[:number], offers[number:]
        used += offer.cells + 2
    return offers, ()


def _offers_line(offers: Sequence[Offer]) -> Text:
    text = Text(no_wrap=True)
    for key, words, action in offers:
        begin = len(text)
        text.append(key, style="bold").append(f" {words}", style="dim").stylize(clickable(action), begin)
        text.append("  ", style="dim")
    return text
