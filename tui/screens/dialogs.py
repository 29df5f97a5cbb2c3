"""Dialogs above the rig screen: the name of a scan, leaving while a sweep runs, help. STOP works in all of them."""

from __future__ import annotations

import re
import time

from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Vertical
from textual.screen import ModalScreen
from textual.widgets import Input, Static

TYPE_AHEAD_S = 0.3
"""A dialog that can do harm ignores keys for so long, so that type-ahead does not answer it."""

_BOX = """
{name} {{ align: center middle; }}
{name} > Vertical {{ width: 64; max-width: 96%; height: auto; border: thick $primary; padding: 1 2;
                     background: $surface; }}
"""

HELP = """\
s      start a sweep (asks for a name)
p      pause: the stage holds, nothing is lost
r      resume
SPACE  STOP, everywhere and at once; frames taken are kept
       (confirmed by the rig's state, not by the key)
a      acknowledge the newest fault
q      leave; the sweep goes on without this screen
?      this help; Escape closes it

committed: in the file, survives the death of any program
durable:   survives a power cut
credit:    frames that may be triggered before the writer must answer"""


def valid_name(text: str) -> bool:
    """True if ``text`` can be part of a folder's name."""
    return re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", text) is not None


class AskName(ModalScreen[str | None]):
    """Asks for the name of a scan; None when it was left."""

    DEFAULT_CSS = _BOX.format(name="AskName")
    BINDINGS = [Binding("escape", "leave", "leave")]

    def __init__(self, default: str) -> None:
        super().__init__()
        self._default = default

    def compose(self) -> ComposeResult:
        """A question, its field, a hint."""
        with Vertical():
            yield Static("Name of the scan (letters, digits, - _ .)")
            yield Input(self._default, id="name", select_on_focus=True)
            yield Static("Enter starts the sweep, Escape leaves; SPACE is STOP", id="hint")

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Start if the name will do, else say what is wrong."""
        if valid_name(event.value):
            self.dismiss(event.value)
        else:
            self.query_one("#hint", Static).update("that is no name: use 1 to 64 letters, digits, - _ . without spaces")

    def action_leave(self) -> None:
        """Start nothing."""
        self.dismiss(None)


class ConfirmQuit(ModalScreen[bool]):
    """Asks before a sweep that would end with this program is given up."""

    DEFAULT_CSS = _BOX.format(name="ConfirmQuit")
    BINDINGS = [Binding("y", "answer(True)", "end"), Binding("n,escape", "answer(False)", "stay")]

    def __init__(self) -> None:
        super().__init__()
        self._opened_s = time.monotonic()

    def compose(self) -> ComposeResult:
        """The question and its two answers."""
        with Vertical():
            yield Static("A sweep is running, and it ends with this demonstration.")
            yield Static("The frames taken so far are kept.\n")
            yield Static("y  end it and leave      n  stay")

    def action_answer(self, leave: bool) -> None:
        """Leave or stay; an answer typed before the question was there does not count."""
        if not leave or time.monotonic() - self._opened_s >= TYPE_AHEAD_S:
            self.dismiss(leave)


class Help(ModalScreen[None]):
    """The keys and the words."""

    DEFAULT_CSS = _BOX.format(name="Help").replace("width: 64", "width: 76")
    BINDINGS = [Binding("escape,q,question_mark", "dismiss(None)", "close")]

    def compose(self) -> ComposeResult:
        """One text."""
        with Vertical():
            yield Static(HELP, markup=False)
