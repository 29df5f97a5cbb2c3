"""The searchable list of actions: help of one screen, or the palette over all; shows why an action cannot be done now.

Not Textual's command palette: that one has neither keys nor reasons.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Vertical
from textual.widgets import Input, OptionList, Static
from textual.widgets.option_list import Option

from tui.console.screen_table import SCREENS
from tui.console.screens.base import RigScreenBase
from tui.console.screens.dialogs import STOP_HINT, Dialog, LineInput

GLOSSARY = (
    "committed: in the file, survives the death of any program; durable: survives a power cut; "
    "credit: frames that may be triggered before the writer must answer"
)


@dataclass(frozen=True)
class ActionEntry:
    """One action of the list."""

    screen: str
    """Name of its screen; empty for an action that every screen has."""
    key: str
    words: str
    action: str
    why_not: str
    """Why it cannot be done now; empty if it can."""

    def matches(self, text: str) -> bool:
        """True if every word of ``text`` occurs."""
        mine = f"{self.screen} {self.key} {self.words}".lower()
        return all(word in mine for word in text.lower().replace("_", " ").split())

    def line(self) -> Text:
        """Key, words, and the reason where it cannot be done."""
        text = Text(no_wrap=True, overflow="ellipsis")
        text.append(f"{self.key:>5}  ", style="bold")
        if self.why_not:
            return text.append(self.words, style="dim").append(f"  not now: {self.why_not}", style="dim italic")
        return text.append(self.words)


class ActionList(Dialog[tuple[str, str] | None]):
    """Answers with the screen and the action that was chosen; None when it was left."""

    TAKES_TEXT = True
    BINDINGS = [
        Binding("escape", "leave", "leave"),
        Binding("down", "move(1)", "next", show=False),
        Binding("up", "move(-1)", "previous", show=False),
        Binding("pagedown", "move(8)", "page down", show=False),
        Binding("pageup", "move(-8)", "page up", show=False),
    ]
    DEFAULT_CSS = """
    ActionList > Vertical { width: 92; height: 96%; }
    ActionList OptionList { height: 1fr; border: none; padding: 0; background: $surface; scrollbar-size-vertical: 1; }
    ActionList Input { margin: 0 0 1 0; }
    """

    def __init__(self, title: str, summary: str, entries: list[ActionEntry]) -> None:
        super().__init__()
        self._title_words, self._summary, self.entries = title, summary, entries
        self.found = entries
        """The entries that match the search."""

    @classmethod
    def of_screen(cls, screen: RigScreenBase) -> ActionList:
        """Help: everything that can be done on one screen."""
        return cls(f"help: {screen.NAME}", f"{screen.SUMMARY} {GLOSSARY}".strip(), _entries(screen))

    @classmethod
    def of_all(cls, here: RigScreenBase, others: Sequence[RigScreenBase]) -> ActionList:
        """Palette: everything that can be done on any screen."""
        entries = _entries(here)
        for number, entry in enumerate(SCREENS, 1):
            words = f"go to {entry.name}: {entry.summary}"
            entries.append(ActionEntry("", str(number), words, f"go('{entry.name}')", ""))
        for screen in others:
            entries += [entry for entry in _entries(screen) if entry.screen]
        return cls("actions", "", entries)

    def compose(self) -> ComposeResult:
        """The search field, the list, the summary."""
        with Vertical() as box:
            box.border_title = self._title_words
            yield LineInput(placeholder=f"type to search; Enter runs it, Escape leaves; {STOP_HINT}", id="search")
            yield OptionList(*self._options(), id="found")
            if self._summary:
                yield Static(self._summary, classes="hint", markup=False)

    def on_mount(self) -> None:
        """The first entry is chosen."""
        self.query_one(OptionList).can_focus = False
        self._choose_first()

    def _choose_first(self) -> None:
        self.query_one(OptionList).highlighted = 0 if self.found else None

    def _options(self) -> list[Option]:
        return [Option(entry.line()) for entry in self.found] or [Option("no action matches", disabled=True)]

    def on_input_changed(self, event: Input.Changed) -> None:
        """Show what matches."""
        self.found = [entry for entry in self.entries if entry.matches(event.value)]
        options = self.query_one(OptionList)
        options.clear_options()
        options.add_options(self._options())
        self._choose_first()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Run the chosen entry."""
        self._answer(self.query_one(OptionList).highlighted)

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        """Run the clicked entry."""
        self._answer(event.option_index)

    def _answer(self, index: int | None) -> None:
        if index is not None and index < len(self.found):
            entry = self.found[index]
            self.dismiss((entry.screen, entry.action))

    def action_move(self, lines: int) -> None:
        """Choose another entry."""
        options = self.query_one(OptionList)
        if self.found:
            options.highlighted = max(0, min(len(self.found) - 1, (options.highlighted or 0) + lines))


def _entries(screen: RigScreenBase) -> list[ActionEntry]:
    entries = []
    for binding in screen.actions():
        why_not = screen.why_not_now(binding.action)
        more = binding.tooltip if binding.tooltip and not why_not else ""
        words = f"{binding.description}: {more}" if more else binding.description
        name = screen.NAME if screen.is_own(binding.action) else ""
        entries.append(ActionEntry(name, screen.shell.key_label(binding), words, binding.action, why_not))
    return entries
