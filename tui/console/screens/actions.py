"""The searchable list of actions: help of one screen, or the palette over all; shows why something cannot be done."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Vertical
from textual.widgets import Input, OptionList, Static
from textual.widgets.option_list import Option

from tui.console.screen_table import SCREENS
from tui.console.screens.base import RigScreenBase, action_name
from tui.console.screens.dialogs import Dialog, PlainInput

if TYPE_CHECKING:
    from tui.console.app import ConsoleApp

GLOSSARY = (
    "committed: in the file, survives the death of any program; durable: survives a power cut; "
    "credit: frames that may be triggered before the writer must answer"
)


@dataclass(frozen=True)
class Entry:
    """One action of the list."""

    screen: str
    """Name of its screen; empty for the console's own."""
    key: str
    words: str
    action: str
    why_not: str
    """Why it cannot be done now; empty if it can."""

    def matches(self, text: str) -> bool:
        """True if every word of ``text`` occurs."""
        mine = f"{self.screen} {self.key} {self.words}".lower()
        return all(word in mine for word in text.lower().replace("_", " ").split())


class ActionList(Dialog[tuple[str, str] | None]):
    """Answers with the screen and the action that was chosen; None when it was left."""

    BINDINGS = [
        Binding("escape", "leave", "leave"),
        Binding("down", "move(1)", "next", show=False),
        Binding("up", "move(-1)", "previous", show=False),
        Binding("pagedown", "move(8)", "further", show=False),
        Binding("pageup", "move(-8)", "back", show=False),
    ]
    DEFAULT_CSS = """
    ActionList > Vertical { width: 92; height: 96%; }
    ActionList OptionList { height: 1fr; border: none; padding: 0; background: $surface; scrollbar-size-vertical: 1; }
    ActionList Input { margin: 0 0 1 0; }
    """

    def __init__(self, title: str, summary: str, entries: list[Entry]) -> None:
        super().__init__()
        self._title_words, self._summary, self._entries = title, summary, entries
        self._found = entries

    @classmethod
    def of_screen(cls, screen: RigScreenBase) -> ActionList:
        """Help: everything that can be done on one screen."""
        return cls(f"help: {screen.NAME}", f"{screen.SUMMARY} {GLOSSARY}".strip(), _entries(screen, screen.actions()))

    @classmethod
    def of_all(cls, shell: ConsoleApp, here: RigScreenBase) -> ActionList:
        """Palette: everything that can be done on any screen."""
        entries = _entries(here, here.actions())
        for number, entry in enumerate(SCREENS, 1):
            words = f"go to {entry.name}: {entry.words}"
            entries.append(Entry("", str(number), words, f"go('{entry.name}')", ""))
            if entry.name != here.NAME:
                screen = shell.screen_named(entry.name)
                entries += [found for found in _entries(screen, screen.actions()) if found.screen]
        return cls("actions", "", entries)

    def compose(self) -> ComposeResult:
        """A field to search with, the list, one line of words."""
        with Vertical() as box:
            box.border_title = self._title_words
            yield PlainInput(placeholder="type to search; Enter does it, Escape leaves, SPACE is STOP", id="search")
            yield OptionList(*self._options(), id="found")
            if self._summary:
                yield Static(self._summary, classes="hint", markup=False)

    def on_mount(self) -> None:
        """The first entry is chosen."""
        self.query_one(OptionList).can_focus = False
        self._choose_first()

    def _choose_first(self) -> None:
        self.query_one(OptionList).highlighted = 0 if self._found else None

    def _options(self) -> list[Option]:
        return [Option(_line(entry)) for entry in self._found] or [Option("nothing is called that", disabled=True)]

    def on_input_changed(self, event: Input.Changed) -> None:
        """Show what matches."""
        self._found = [entry for entry in self._entries if entry.matches(event.value)]
        found = self.query_one(OptionList)
        found.clear_options()
        found.add_options(self._options())
        self._choose_first()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Do what is chosen."""
        self._answer(self.query_one(OptionList).highlighted)

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        """Do what was clicked."""
        self._answer(event.option_index)

    def _answer(self, index: int | None) -> None:
        if index is not None and index < len(self._found):
            entry = self._found[index]
            self.dismiss((entry.screen, entry.action))

    def action_move(self, lines: int) -> None:
        """Choose another entry."""
        found = self.query_one(OptionList)
        if self._found:
            found.highlighted = max(0, min(len(self._found) - 1, (found.highlighted or 0) + lines))


def _entries(screen: RigScreenBase, bindings: list[Binding]) -> list[Entry]:
    entries = []
    for binding in bindings:
        own = hasattr(screen, f"action_{action_name(binding.action)}")
        why_not = screen.why_not_now(binding.action)
        more = binding.tooltip if binding.tooltip and not why_not else ""
        words = f"{binding.description}: {more}" if more else binding.description
        key = screen.shell.key_words(binding)
        entries.append(Entry(screen.NAME if own else "", key, words, binding.action, why_not))
    return entries


def _line(entry: Entry) -> Text:
    text = Text(no_wrap=True, overflow="ellipsis")
    text.append(f"{entry.key:>5}  ", style="bold")
    if entry.why_not:
        return text.append(entry.words, style="dim").append(f"  not now: {entry.why_not}", style="dim italic")
    return text.append(entry.words)
