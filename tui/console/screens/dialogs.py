"""Dialogs above a screen: forms and confirmations. STOP works in all of them; what can do harm ignores type-ahead."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Grid, Vertical
from textual.screen import ModalScreen
from textual.widgets import Input, Static

TYPE_AHEAD_S = 0.3
"""A dialog that can do harm ignores keys for so long, so that type-ahead does not answer it."""
STOP_HINT = "CTRL+X = STOP while this is open"

R = TypeVar("R")


class Dialog(ModalScreen[R]):
    """A box in the middle of the screen."""

    DANGEROUS: ClassVar[bool] = False
    """True: keys that were typed before the dialog could be read are ignored."""
    TAKES_TEXT: ClassVar[bool] = False
    """True: the space bar types a space here, and only ctrl+x is STOP."""
    DEFAULT_CSS = """
    Dialog { align: center middle; background: $background 60%; }
    Dialog > Vertical { width: 72; max-width: 96%; height: auto; max-height: 96%; border: round $accent;
                        border-title-color: $text; padding: 0 1; background: $surface; }
    Dialog .hint { color: $text-muted; height: auto; }
    Dialog .error { color: $text-warning; text-style: bold; height: auto; }
    """

    def __init__(self) -> None:
        super().__init__()
        self._shown_s: float | None = None

    def may_take(self, key: str, now_s: float) -> bool:
        """False for a key that must have been typed before the dialog was shown."""
        if self._shown_s is None:
            self._shown_s = now_s
        return not self.DANGEROUS or key in ("n", "escape") or now_s - self._shown_s >= TYPE_AHEAD_S

    def on_mount(self) -> None:
        """From now on it can be read."""
        if self._shown_s is None:
            self._shown_s = getattr(self.app, "now_s", time.monotonic)()
        self._show_stop_key()

    def on_unmount(self) -> None:
        """The screen beneath is in view again."""
        self._show_stop_key()

    def _show_stop_key(self) -> None:
        refresh_view = getattr(self.app, "refresh_view", None)
        if self.TAKES_TEXT and refresh_view is not None:
            refresh_view()

    def action_leave(self) -> None:
        """Leave without an answer."""
        self.dismiss(None)


class LineInput(Input):
    """A field of one line without a frame."""

    DEFAULT_CSS = """
    LineInput, LineInput:focus { border: none; height: 1; padding: 0; background: $panel; }
    LineInput:focus { background: $primary 40%; }
    """


@dataclass(frozen=True)
class FormField:
    """One line of a form."""

    name: str
    label: str
    value: str
    help: str = ""
    """Unit, limits, an example."""


class FormDialog(Dialog[Any]):
    """Asks for several values; the answer is what ``parse`` makes of the texts, None when it was left."""

    TAKES_TEXT = True
    BINDINGS = [
        Binding("escape", "leave", "leave"),
        Binding("up", "app.focus_previous", "previous", show=False),
        Binding("down", "app.focus_next", "next", show=False),
    ]
    DEFAULT_CSS = """
    FormDialog Grid { grid-size: 2; grid-columns: 18 1fr; grid-rows: auto; height: auto; }
    FormDialog Grid Static { height: auto; }
    FormDialog #lines { height: auto; }
    """

    def __init__(
        self,
        title: str,
        fields: Sequence[FormField],
        parse: Callable[[dict[str, str]], Any],
        *,
        done: str = "accepts",
        lines: Sequence[str] = (),
    ) -> None:
        """``parse`` raises ValueError that says what is wrong; ``done`` says what Enter does; ``lines`` stand above."""
        super().__init__()
        self._title_words, self._fields, self._parse, self._done, self._lines = title, fields, parse, done, lines

    def compose(self) -> ComposeResult:
        """Labels and fields, hints, a line for errors."""
        with Vertical() as box:
            box.border_title = self._title_words
            with Vertical(id="lines"):
                yield from _statics(self._lines)
            with Grid():
                for field in self._fields:
                    yield Static(field.label, markup=False)
                    yield LineInput(field.value, id=f"field-{field.name}", select_on_focus=True)
            for field in self._fields:
                if field.help:
                    yield Static(f"{field.label}: {field.help}", classes="hint", markup=False)
            hint = f"Enter {self._done}, Tab goes to the next field, Escape leaves"
            yield Static(hint, classes="hint", markup=False)
            yield Static(STOP_HINT, classes="error", markup=False)
            yield Static("", id="wrong", classes="error", markup=False)

    def show_lines(self, lines: Sequence[str]) -> None:
        """Replace the lines above the fields."""
        if self.is_mounted and list(lines) != list(self._lines):
            self._lines = lines
            above = self.query_one("#lines")
            above.remove_children()
            above.mount(*_statics(lines))

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Answer if the values are valid, else say what is wrong."""
        texts = {field.name: self.query_one(f"#field-{field.name}", Input).value.strip() for field in self._fields}
        try:
            answer = self._parse(texts)
        except ValueError as error:
            self.query_one("#wrong", Static).update(str(error))
            return
        self.dismiss(answer)


def _statics(lines: Sequence[str]) -> list[Static]:
    return [Static(line, classes="error" if line.startswith("!") else "", markup=False) for line in lines]


class Confirm(Dialog[bool]):
    """Asks before something that can do harm; ``y`` is another key than any that opens the question."""

    DANGEROUS = True
    BINDINGS = [Binding("n,escape", "answer(False)", "no"), Binding("y", "answer(True)", "yes")]

    def __init__(self, lines: Sequence[str], yes: str, *, no: str = "leave it") -> None:
        super().__init__()
        self._lines, self._yes, self._no = lines, yes, no

    def compose(self) -> ComposeResult:
        """The question and its two answers."""
        with Vertical():
            for line in self._lines:
                yield Static(line, markup=False)
            yield Static(f"\ny  {self._yes}      n  {self._no}", markup=False)

    def action_answer(self, answer: bool) -> None:
        """Yes or no."""
        self.dismiss(answer)
