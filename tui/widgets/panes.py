"""The panes of the rig screen: title line, state, sweep, fault banner, key line."""

from __future__ import annotations

from rich.text import Text

from acquire.contract.messages import ResultProgress, Status
from tui.fit import shorten
from tui.widgets.frame import NOT_CONNECTED
from tui.widgets.lines import Lines
from tui.words import (
    UNKNOWN_SIGN,
    Sign,
    bar,
    credit_words,
    fraction_done,
    is_running,
    outcome_line,
    position_words,
    rate_words,
    scan_name,
    sign_of,
    state_words,
    worker_words,
)

COUNTS = ("triggered", "received", "committed", "durable", "retaken", "missing")


class StatePane(Lines):
    """What the rig is doing and where the stage is."""

    DEFAULT_CSS = "StatePane { height: 5; border: round $primary; border-title-color: $text; padding: 0 1; }"

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(id="state", ascii_only=ascii_only)
        self.border_title = "rig"
        self.status: Status | None = None
        self.connected = False
        self.stop_words = ""

    def text_for(self, width: int) -> Text:
        """Three lines: state, position, scan."""
        text = Text(no_wrap=True)
        self._state_line(text)
        if self.status is None:
            return text.append("\nposition  not known\nscan      none yet", style="dim")
        style = "" if self.connected else "dim"
        text.append(f"\nposition  {position_words(self.status)}", style=style)
        name = scan_name(self.status) or "none yet"
        return text.append(f"\nscan      {shorten(name, max(8, width - 10))}", style=style)

    def _state_line(self, text: Text) -> None:
        if not self.connected:
            self._sign(text, UNKNOWN_SIGN)
            text.append(NOT_CONNECTED.upper(), style="bold yellow")
            if self.status is not None:
                text.append(f"   last known: {state_words(self.status)}", style="dim")
        elif self.status is not None:
            sign = sign_of(self.status.state)
            self._sign(text, sign)
            text.append(state_words(self.status), style=f"bold {_COLOURS[sign.colour]}")
        if self.stop_words:
            text.append(f"   {self.stop_words}", style="bold reverse")

    def _sign(self, text: Text, sign: Sign) -> None:
        glyph = sign.ascii_glyph if self.ascii_only else sign.glyph
        text.append(f"{glyph} ", style=f"bold {_COLOURS[sign.colour]}")


_COLOURS = {
    "success": "green",
    "warning": "yellow",
    "error": "red",
    "primary": "#4aa3ff",
    "accent": "cyan",
}


class SweepPane(Lines):
    """Frames at every hop, progress, credit, and how far the cloud is."""

    DEFAULT_CSS = "SweepPane { height: 8; border: round $primary; border-title-color: $text; padding: 0 1; }"

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(id="sweep", ascii_only=ascii_only)
        self.border_title = "sweep"
        self.status: Status | None = None
        self.progress: ResultProgress | None = None
        self.connected = False

    def text_for(self, width: int) -> Text:
        """Six lines: counts under their names, bar, rate, worker, outcome."""
        status = self.status
        if status is None or not status.expected:
            return Text("no sweep yet: s starts one" if status else "nothing is known of a sweep", style="dim")
        text = Text(no_wrap=True, style="" if self.connected else "dim")
        text.append("".join(f"{name:>11}" for name in COUNTS)[1:], style="dim")
        text.append("\n" + "".join(f"{getattr(status, name):>11}" for name in COUNTS)[1:], style="bold")
        share = f" {status.committed}/{status.expected} {100 * fraction_done(status):3.0f} %"
        room = max(4, width - len(share))
        text.append("\n").append(
            bar(fraction_done(status), room, ascii_only=self.ascii_only), style=_COLOURS["primary"]
        )
        text.append(share)
        text.append(f"\n{rate_words(status)}  {credit_words(status)}" if is_running(status) else "\n")
        text.append("\n" + shorten(self._worker(), width))
        return text.append("\n").append(outcome_line(status), style=_outcome_style(status))

    def _worker(self) -> str:
        trouble = self.progress.message if self.progress else ""
        return f"worker: {trouble}" if trouble else worker_words(self.progress)


def _outcome_style(status: Status) -> str:
    return "bold green" if outcome_line(status).startswith("SAVED") else "bold yellow"
