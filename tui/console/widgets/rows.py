"""A list of rows with a cursor that scrolls as it moves.

Textual's OptionList and DataTable show the cursor by colour alone and repaint when equal rows are set again; here the
row of the cursor has a mark, and the chosen key survives a change of the rows.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field

from rich.text import Text
from textual.events import Click, MouseScrollDown, MouseScrollUp
from textual.message import Message

from tui.console.widgets.lines import Pane


@dataclass(frozen=True)
class Rows:
    """What a list shows; ``keys`` identify the rows."""

    header: Text = field(default_factory=Text)
    rows: Sequence[Text] = ()
    keys: Sequence[Hashable] = ()


class RowList(Pane[Rows]):
    """Shows rows that it is given."""

    class Moved(Message):
        """Another row is chosen."""

    def __init__(self, *, empty: str) -> None:
        """``empty`` is shown while there are no rows."""
        super().__init__(Rows())
        self._empty = empty
        self._top = 0
        self.cursor = 0

    @property
    def chosen(self) -> Hashable | None:
        """The key of the row under the cursor; None while there are none."""
        return self.shown.keys[self.cursor] if self.shown.keys else None

    def show(self, value: Rows) -> None:
        """Take rows; the cursor stays on its key where that is still there."""
        before = self.chosen
        if before in value.keys:
            self.cursor = list(value.keys).index(before)
        self.cursor = max(0, min(self.cursor, len(value.rows) - 1))
        super().show(value)

    def say_when_empty(self, words: str) -> None:
        """What is shown while there are no rows."""
        self._empty = words
        self.changed()

    def move(self, rows: int) -> None:
        """Move the cursor; it stops at the ends."""
        wanted = max(0, min(self.cursor + rows, len(self.shown.rows) - 1))
        if wanted != self.cursor:
            self.cursor = wanted
            self.post_message(self.Moved())
        self.changed()

    @property
    def page(self) -> int:
        """Number of rows in view."""
        return max(1, self.content_size.height - 1)

    def on_click(self, event: Click) -> None:
        """Choose the clicked row."""
        place = event.get_content_offset(self)
        if place is not None and place.y >= 1:
            self.move(self._top + place.y - 1 - self.cursor)

    def on_mouse_scroll_down(self, _event: MouseScrollDown) -> None:
        """Move down."""
        self.move(3)

    def on_mouse_scroll_up(self, _event: MouseScrollUp) -> None:
        """Move up."""
        self.move(-3)

    def text_for(self, width: int) -> Text:
        """The header and the rows around the cursor."""
        rows = self.shown.rows
        if not rows:
            return Text(self._empty, style="dim")
        page = self.page
        self._top = max(min(self._top, self.cursor), self.cursor - page + 1, 0)
        self._top = min(self._top, max(0, len(rows) - page))
        text = Text("  ", no_wrap=True, overflow="ellipsis")
        text.append_text(_styled(self.shown.header, "dim", width - 2))
        for number in range(self._top, min(len(rows), self._top + page)):
            here = number == self.cursor
            text.append("\n").append("▸ " if here else "  ", style="bold")
            row = Text(rows[number].plain) if here else rows[number]
            text.append_text(_styled(row, "reverse" if here else "", width - 2))
        return text


def _styled(line: Text, style: str, width: int) -> Text:
    found = line.copy()
    found.truncate(max(0, width), overflow="crop", pad=True)
    found.stylize(style)
    return found
