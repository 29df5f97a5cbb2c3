"""A list of lines with a cursor that scrolls as it moves; the row under the cursor carries a sign, not colour alone."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

from rich.text import Text
from textual.events import Click, MouseScrollDown, MouseScrollUp
from textual.message import Message

from tui.console.widgets.lines import Lines


class RowList(Lines):
    """Shows rows that it is given; which one is chosen survives a change of the rows."""

    DEFAULT_CSS = """
    RowList { height: 1fr; border: round $primary 60%; border-title-color: $text-muted; padding: 0 1; }
    """

    class Moved(Message):
        """Another row is chosen."""

    def __init__(self, *, id: str, ascii_only: bool = False, empty: str = "") -> None:  # noqa: A002 - Textual's name
        super().__init__(id=id, ascii_only=ascii_only)
        self._header = Text()
        self._rows: Sequence[Text] = ()
        self._keys: Sequence[Hashable] = ()
        self._empty = empty
        self._top = 0
        self.cursor = 0

    @property
    def chosen(self) -> Hashable | None:
        """The key of the row under the cursor; None while there are none."""
        return self._keys[self.cursor] if self._keys else None

    def show(self, header: Text, rows: Sequence[Text], keys: Sequence[Hashable]) -> None:
        """Take rows with their keys; the cursor stays on its key where that is still there."""
        before = self.chosen
        self._header, self._rows, self._keys = header, rows, keys
        if before in keys:
            self.cursor = list(keys).index(before)
        self.cursor = max(0, min(self.cursor, len(rows) - 1))
        self.changed()

    def say_when_empty(self, words: str) -> None:
        """What stands there while there are no rows."""
        self._empty = words
        self.changed()

    def choose(self, key: Hashable) -> None:
        """Put the cursor on a row."""
        if key in self._keys:
            self.move(list(self._keys).index(key) - self.cursor)

    def move(self, rows: int) -> None:
        """Move the cursor; it stops at the ends."""
        wanted = max(0, min(self.cursor + rows, len(self._rows) - 1))
        if wanted != self.cursor:
            self.cursor = wanted
            self.post_message(self.Moved())
        self.changed()

    @property
    def page(self) -> int:
        """Rows in view."""
        return max(1, self.content_size.height - 1)

    def on_click(self, event: Click) -> None:
        """Choose what was clicked."""
        row = event.get_content_offset(self)
        if row is not None and row.y >= 1:
            self.move(self._top + row.y - 1 - self.cursor)

    def on_mouse_scroll_down(self, _event: MouseScrollDown) -> None:
        """Further."""
        self.move(3)

    def on_mouse_scroll_up(self, _event: MouseScrollUp) -> None:
        """Back."""
        self.move(-3)

    def text_for(self, width: int) -> Text:
        """The header and the rows around the cursor."""
        if not self._rows:
            return Text(self._empty, style="dim")
        page = self.page
        self._top = max(min(self._top, self.cursor), self.cursor - page + 1, 0)
        self._top = min(self._top, max(0, len(self._rows) - page))
        text = Text("  ", no_wrap=True, overflow="ellipsis" if not self.ascii_only else "crop")
        text.append_text(_styled(self._header, "dim", width - 2))
        mark = ">" if self.ascii_only else "▸"
        for number in range(self._top, min(len(self._rows), self._top + page)):
            here = number == self.cursor
            text.append("\n").append(f"{mark} " if here else "  ", style="bold")
            row = Text(self._rows[number].plain) if here else self._rows[number]
            text.append_text(_styled(row, "reverse" if here else "", width - 2))
        return text


def _styled(line: Text, style: str, width: int) -> Text:
    found = line.copy()
    found.truncate(max(0, width), overflow="crop", pad=True)
    if style:
        found.stylize(style)
    return found
