"""The log as wrapped lines, from a few rows of its end to a whole screen that is scrolled back."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence

from rich.text import Text

from tui.console.state.session_log import LogLine
from tui.console.widgets.frame import LEVEL_STYLES
from tui.console.widgets.lines import Pane

_MARKS = {"info": "", "warning": "! ", "error": "✖ "}


class LogPane(Pane[Sequence[LogLine]]):
    """Follows the newest line, unless it was scrolled back."""

    BORDER_TITLE = "log"
    back = 0
    """Rows between the last one in view and the newest; 0 follows."""

    def show(self, value: Sequence[LogLine]) -> None:
        """Take the lines; what is in view stays where it is unless it follows."""
        if self.back and len(value) > len(self.shown):
            self.back += sum(1 for _ in _rows(value[len(self.shown) :], self.content_size.width))
        super().show(value)

    def scroll_rows(self, rows: int) -> None:
        """Back (positive) or towards the newest."""
        count = sum(1 for _ in _rows(self.shown, self.content_size.width))
        self.back = max(0, min(self.back + rows, count - self.content_size.height))
        self.changed()

    def text_for(self, width: int) -> Text:
        """As many rows as there is room for."""
        wanted = max(1, self.content_size.height)
        rows: list[Text] = []
        for line in reversed(self.shown):
            rows = [*_rows([line], width), *rows]
            if len(rows) >= wanted + self.back:
                break
        end = max(0, len(rows) - self.back)
        text = Text("\n", no_wrap=True).join(rows[max(0, end - wanted) : end])
        return text if rows else Text("no lines: the filter hides all, or nothing happened yet", style="dim")


def _rows(lines: Sequence[LogLine], width: int) -> Iterator[Text]:
    """The lines as rows of at most ``width`` cells; the level is said by a mark, not by colour alone."""
    for line in lines:
        words = f"{line.at} {_MARKS[line.level]}{line.text}"
        for number, row in enumerate(textwrap.wrap(words, max(20, width), subsequent_indent=" " * 9)):
            text = Text(row, style=LEVEL_STYLES[line.level], no_wrap=True)
            text.stylize("dim", 0, 0 if number else len(line.at))
            yield text
