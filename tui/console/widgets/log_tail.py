"""The newest lines of the log, as many as there is room for."""

from __future__ import annotations

import textwrap

from rich.text import Text

from tui.console.state.logbook import LogBook
from tui.console.widgets.frame import LEVEL_STYLES
from tui.console.widgets.lines import Lines


class LogTail(Lines):
    """Shows the end of the log, wrapped; the whole of it is on the log screen."""

    DEFAULT_CSS = """
    LogTail { height: 1fr; min-height: 1; border: round $primary 60%; border-title-color: $text-muted; padding: 0 1; }
    """

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(id="log", ascii_only=ascii_only)
        self.border_title = "log"
        self._book = LogBook()

    def show(self, book: LogBook) -> None:
        """Take the log."""
        self._book = book
        self.changed()

    def text_for(self, width: int) -> Text:
        """The newest lines from below."""
        rows: list[tuple[str, str]] = []
        for line in reversed(self._book.lines):
            wrapped = textwrap.wrap(f"{line.at} {line.text}", max(20, width), subsequent_indent=" " * 9)
            rows = [(row, LEVEL_STYLES[line.level]) for row in wrapped] + rows
            if len(rows) >= max(1, self.content_size.height):
                break
        text = Text(no_wrap=True)
        for row, style in rows[-max(1, self.content_size.height) :]:
            text.append(row + "\n", style=style)
        text.right_crop(1)
        return text
