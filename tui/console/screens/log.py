"""The log screen: all news of this session, filtered by level and text."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding

from tui.console.link.rig_view import RigView
from tui.console.screens.base import RigScreenBase
from tui.console.screens.dialogs import Field, Form
from tui.console.state.logbook import LogLine
from tui.console.widgets.frame import LEVEL_STYLES
from tui.console.widgets.lines import Lines

LEVELS = (("all", ("info", "warning", "error")), ("warnings and errors", ("warning", "error")), ("errors", ("error",)))


def filtered(lines: Sequence[LogLine], level: int, text: str) -> list[LogLine]:
    """The lines of the levels ``LEVELS[level]`` that hold every word of ``text``."""
    levels, words = LEVELS[level][1], text.lower().split()
    return [line for line in lines if line.level in levels and all(word in line.text.lower() for word in words)]


class LogView(Lines):
    """The lines, wrapped; scrolled by rows from the end, where it follows."""

    DEFAULT_CSS = """
    LogView { height: 1fr; border: round $primary 60%; border-title-color: $text-muted; padding: 0 1; }
    """

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(id="log", ascii_only=ascii_only)
        self._lines: list[LogLine] = []
        self.back = 0
        """Rows between the last one in view and the newest; 0 follows."""

    def show(self, lines: list[LogLine]) -> None:
        """Take the lines; what is in view stays where it is unless it follows."""
        if self.back and len(lines) > len(self._lines):
            self.back += len(self._rows(lines[len(self._lines) :], self.content_size.width))
        self._lines = lines
        self.changed()

    def scroll_rows(self, rows: int) -> None:
        """Back (positive) or towards the newest."""
        most = len(self._rows(self._lines, self.content_size.width)) - self.content_size.height
        self.back = max(0, min(self.back + rows, most))
        self.changed()

    def _rows(self, lines: Sequence[LogLine], width: int) -> list[tuple[str, str, str]]:
        rows = []
        for line in lines:
            wrapped = textwrap.wrap(line.text, max(20, width - 12)) or [""]
            mark = {"info": " ", "warning": "!", "error": "X"}[line.level]
            rows.append((line.at, f" {mark} {wrapped[0]}", LEVEL_STYLES[line.level]))
            rows += [("", f"   {more}", LEVEL_STYLES[line.level]) for more in wrapped[1:]]
        return rows

    def text_for(self, width: int) -> Text:
        """As many rows as there is room for."""
        rows = self._rows(self._lines, width)
        end = max(0, len(rows) - self.back)
        text = Text(no_wrap=True)
        for at, words, style in rows[max(0, end - max(1, self.content_size.height)) : end]:
            text.append(f"{at:<8}", style="dim").append(words + "\n", style=style)
        text.right_crop(1)
        return text if rows else Text("nothing here: the filter hides it, or nothing was said", style="dim")


class LogScreen(RigScreenBase):
    """Every line that was said in this session."""

    NAME = "log"
    SUMMARY = "What the services themselves write is in the journal: 'sweepscope logs'."
    SHOWS_LOG = True
    BINDINGS = [
        Binding("up", "scroll_rows(1)", "back", show=False),
        Binding("down", "scroll_rows(-1)", "further", show=False),
        Binding("pageup", "scroll_page(1)", "back", id="log.back", tooltip="a page back"),
        Binding("pagedown", "scroll_page(-1)", "further", id="log.further", tooltip="a page towards the newest"),
        Binding("end", "follow", "newest", id="log.follow", tooltip="the newest line, and follow"),
        Binding("l", "level", "level", id="log.level", tooltip="all, warnings and errors, errors only"),
        Binding("slash", "search", "filter", id="log.filter", tooltip="only lines that hold these words"),
        Binding("escape", "clear", "no filter", id="log.clear", tooltip="show all lines again"),
        Binding("c", "copy", "copy", id="log.copy", tooltip="the lines in the filter to the clipboard"),
    ]

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(ascii_only=ascii_only)
        self._log = LogView(ascii_only=ascii_only)
        self._level, self._text = 0, ""
        self._shown: list[LogLine] = []

    def body(self) -> ComposeResult:
        """One pane."""
        yield self._log

    def show(self, view: RigView) -> None:
        """Take the log."""
        book = self.shell.logbook
        self._shown = filtered(book.lines, self._level, self._text)
        gone = book.said - len(book.lines)
        title = f"log: {LEVELS[self._level][0]}" + (f", with '{self._text}'" if self._text else "")
        title += f"  {len(self._shown)} of {book.said} lines" + (f", the oldest {gone} are gone" if gone else "")
        self._log.border_title = title + ("" if not self._log.back else "  (stands still: End follows)")
        self._log.show(self._shown)

    def why_not(self, action: str) -> str:
        """What would change nothing is not offered."""
        if action == "clear" and not self._text and not self._level:
            return "nothing is hidden"
        return "it follows already" if action == "follow" and not self._log.back else ""

    def action_scroll_rows(self, rows: int) -> None:
        """Scroll."""
        self._log.scroll_rows(rows)
        self.show_all(self.view)

    def action_scroll_page(self, direction: int) -> None:
        """Scroll by what is in view."""
        self.action_scroll_rows(direction * max(1, self._log.content_size.height - 1))

    def action_follow(self) -> None:
        """To the newest line."""
        self.action_scroll_rows(-self._log.back)

    def action_level(self) -> None:
        """The next level."""
        self._set((self._level + 1) % len(LEVELS), self._text)

    def action_search(self) -> None:
        """Ask for words."""
        form = Form("filter", [Field("text", "words", self._text, words=True)], lambda texts: texts["text"])
        self.shell.push_screen(form, lambda text: self._set(self._level, text) if text is not None else None)

    def action_clear(self) -> None:
        """Show everything."""
        self._set(0, "")

    def _set(self, level: int, text: str) -> None:
        self._level, self._text, self._log.back = level, text, 0
        self.show_all(self.view)

    def action_copy(self) -> None:
        """The lines as text."""
        self.shell.copy_to_clipboard("".join(f"{line.at} {line.level}: {line.text}\n" for line in self._shown))
        self.say(f"{len(self._shown)} lines copied as text, where the terminal lets programs do that (OSC 52)")
