"""The frame of every screen: header with state and tabs, fault banner, the newest news, the keys."""

from __future__ import annotations

from collections.abc import Sequence

from rich.text import Text

from acquire.contract.messaging.messages import FaultReport
from acquire.contract.states import State, sign_of
from tui.console.link.rig_view import RigView
from tui.console.screen_table import SCREENS
from tui.console.state.logbook import LogLine
from tui.console.widgets.lines import Lines, PressableLines
from tui.text.status_text import newest_fault, state_words
from tui.text.width import shorten

NOT_CONNECTED = "not connected - retrying"
LEVEL_STYLES = {"info": "", "warning": "yellow", "error": "bold red"}
_WARNING = "bold yellow"
STATE_STYLES: dict[str, str] = {
    State.IDLE: "bold green",
    **dict.fromkeys((State.HOMING, State.MOVING, State.PREVIEW, State.ARMED), "bold cyan"),
    **dict.fromkeys((State.SWEEPING, State.FINISHING), "bold #4aa3ff"),
    State.FAULT: "bold red",
}
"""Of the signs of states; all others are painted as a warning."""

Offer = tuple[str, str, str]
"""Key, words, and the action with its namespace, for the mouse."""


class Header(PressableLines):
    """State and devices; the screens; the address of the page while there is one."""

    DEFAULT_CSS = """
    Header { height: 2; background: $panel; padding: 0 1; }
    Header.page { height: 3; }
    """

    def __init__(self, name: str, *, ascii_only: bool = False) -> None:
        super().__init__(id="title", ascii_only=ascii_only)
        self._name = name
        self._view = RigView()
        self._read_only = False

    def show(self, view: RigView, *, read_only: bool) -> None:
        """Take the newest values."""
        self._view, self._read_only = view, read_only
        self.set_class(bool(view.url), "page")
        self.changed()

    def text_for(self, width: int) -> Text:
        """Two or three lines."""
        text = self._state_line(width)
        text.append("\n").append_text(self._tabs_line(width))
        if self._view.url:
            page = f"page  {self._view.url}"
            text.append("\n" + (page if len(page) <= width else self._view.url), style="dim")
        return text

    def _state_line(self, width: int) -> Text:
        view = self._view
        text = Text("sweepscope  ", style="bold", no_wrap=True)
        known = view.connected and view.status is not None
        state = view.status.state if known and view.status else ""
        sign = sign_of(state).ascii_glyph if self.ascii_only else sign_of(state).glyph
        words = state_words(view.status) if known and view.status else NOT_CONNECTED.upper()
        text.append(f"{sign} {words}", style=STATE_STYLES.get(state, _WARNING))
        if view.status is not None and not view.connected:
            text.append(f"  last known: {state_words(view.status)}", style="not bold dim")
        if view.stop_words:
            text.append("  ").append(f" {view.stop_words} ", style="bold reverse")
        right = self._right_words()
        gap = width - text.cell_len - len(right)
        return text.append(" " * gap + right, style="not bold") if gap >= 2 else text

    def _right_words(self) -> str:
        status = self._view.status
        if status is None:
            return ""
        lamp = "on" if status.lamp_on else "off"
        return f"{status.stage_kind} stage  {status.camera_kind} camera  lamp {lamp}"

    def _tabs_line(self, width: int) -> Text:
        self.forget_places()
        text = Text(no_wrap=True)
        for number, entry in enumerate(SCREENS, 1):
            here = entry.name == self._name
            text.append(f" {number} {entry.name} ", style="bold reverse" if here else "dim")
            self.place(1, text.cell_len - len(entry.name) - 4, text.cell_len, f"app.go('{entry.name}')")
        right = self._control_words()
        gap = width - text.cell_len - len(right)
        if gap < 1:  # the holder matters more than the tabs, whose numbers stay known
            right = shorten(right, width // 2)
            text.truncate(max(0, width - len(right) - 1), overflow="ellipsis" if not self.ascii_only else "crop")
            gap = width - text.cell_len - len(right)
        style = "bold yellow" if not self._view.in_control else ""
        return text.append(" " * max(0, gap)).append(right, style=style)

    def _control_words(self) -> str:
        status = self._view.status
        watching = "read-only" if self._read_only else ""
        if status is None or not status.control:
            return watching
        holder = "you" if status.control == self._view.me else status.control
        return f"{watching}  control: {holder}".strip()


class FaultBanner(Lines):
    """The newest fault until it is acknowledged: what happened, what is safe, what to do."""

    DEFAULT_CSS = """
    FaultBanner { height: 3; background: $error; color: $text; padding: 0 1; display: none; }
    FaultBanner.visible { display: block; }
    """

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(id="fault", ascii_only=ascii_only)
        self.fault: FaultReport | None = None
        self.waiting = 0

    def show(self, faults: Sequence[FaultReport]) -> None:
        """Show the newest fault of ``faults`` that waits, or vanish."""
        self.fault = newest_fault(faults)
        self.waiting = sum(not fault.acknowledged for fault in faults)
        self.set_class(self.fault is not None, "visible")
        self.changed()

    def text_for(self, width: int) -> Text:
        """Three lines."""
        if self.fault is None:
            return Text()
        sign = "X" if self.ascii_only else "✖"
        more = f" (and {self.waiting - 1} more)" if self.waiting > 1 else ""
        text = Text(no_wrap=True)
        text.append(shorten(f"{sign} FAULT {self.fault.code}: {self.fault.happened}{more}", width), style="bold")
        text.append("\n" + shorten(f"  safe:  {self.fault.safe}", width))
        return text.append("\n" + shorten(f"  to do: {self.fault.to_do}", width - 27) + "  (a acknowledges, 5 all)")


class NewsLine(Lines):
    """The newest line of the log, for screens that do not show the log."""

    DEFAULT_CSS = "NewsLine { height: 1; padding: 0 1; dock: bottom; margin-bottom: 2; }"

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(id="news", ascii_only=ascii_only)
        self._line: LogLine | None = None

    def show(self, lines: Sequence[LogLine]) -> None:
        """Take the newest line."""
        self._line = lines[-1] if lines else None
        self.changed()

    def text_for(self, width: int) -> Text:
        """One line."""
        if self._line is None:
            return Text()
        return Text(shorten(f"{self._line.at} {self._line.text}", width), LEVEL_STYLES[self._line.level], no_wrap=True)


class KeyLine(PressableLines):
    """The keys that mean something now; help and STOP are there at any width."""

    DEFAULT_CSS = "KeyLine { dock: bottom; height: 2; background: $panel; padding: 0 1; }"
    PINNED = "? help   SPACE = STOP"

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(id="keys", ascii_only=ascii_only)
        self._offers: list[Offer] = []

    def show(self, offers: list[Offer]) -> None:
        """Take key and words of everything that can be done now."""
        self._offers = offers
        self.changed()

    def text_for(self, width: int) -> Text:
        """As many lines as the widget is high; the last one ends with what is pinned."""
        lines, left = _fill(self._offers, [width, width - len(self.PINNED) - 12])
        self.forget_places()
        text = Text(no_wrap=True)
        for number, line in enumerate(lines):
            if number:
                more = f"+{left}  " if left else ""
                text.append("\n")
                used = sum(len(key) + len(words) + 3 for key, words, _ in line)
                tail = " " * max(1, width - used - len(more) - len(self.PINNED))
            x = 0
            for key, words, action in line:
                text.append(key, style="bold").append(f" {words}  ", style="dim")
                self.place(number, x, x + len(key) + len(words) + 1, action)
                x += len(key) + len(words) + 3
        text.append(tail + more, style="dim").append("? help", style="bold").append("   ")
        return text.append("SPACE = STOP", style="bold red")


def _fill(offers: list[Offer], widths: Sequence[int]) -> tuple[list[list[Offer]], int]:
    """The offers that fit into lines of ``widths``, in order, and how many do not."""
    lines: list[list[Offer]] = []
    waiting = list(offers)
    for width in widths:
        line: list[Offer] = []
        used = 0
        while waiting and used + len(waiting[0][0]) + len(waiting[0][1]) + 1 <= width:
            used += len(waiting[0][0]) + len(waiting[0][1]) + 3
            line.append(waiting.pop(0))
        lines.append(line)
    return lines, len(waiting)
