"""A pane of styled lines that repaints only when its text or size changed."""

from __future__ import annotations

from collections.abc import Callable

from rich.text import Text
from textual.events import Click
from textual.widget import Widget

KEY_STYLE = "bold #f0b429"


class Lines(Widget):
    """Shows what :meth:`compose_text` makes of the newest values, cut to the pane's width."""

    ALLOW_SELECT = False

    def __init__(self, *, id: str | None = None, ascii_only: bool = False) -> None:  # noqa: A002 - Textual's name
        super().__init__(id=id)
        self.ascii_only = ascii_only
        self._shown: Text | None = None

    def text_for(self, width: int) -> Text:
        """The lines for a pane that is ``width`` cells wide."""
        raise NotImplementedError

    def changed(self) -> None:
        """Repaint if the text is another one now."""
        text = self.text_for(self.content_size.width)
        if text != self._shown or text.spans != (self._shown.spans if self._shown else []):
            self.refresh()

    def render(self) -> Text:
        """The text; remembered, so that nothing is painted twice."""
        self._shown = self.text_for(self.content_size.width)
        return self._shown

    @property
    def plain(self) -> str:
        """The text without styles, as it would be painted now."""
        return self.text_for(self.content_size.width).plain


class PressableLines(Lines):
    """Lines in which places can be clicked."""

    def __init__(self, *, id: str, ascii_only: bool = False) -> None:  # noqa: A002
        super().__init__(id=id, ascii_only=ascii_only)
        self._places: list[tuple[int, int, int, str]] = []

    def place(self, row: int, begin: int, end: int, action: str) -> None:
        """What a click on the cells ``begin`` to ``end`` of a row does."""
        self._places.append((row, begin, end, action))

    def forget_places(self) -> None:
        """Another text is made."""
        self._places.clear()

    async def on_click(self, event: Click) -> None:
        """Do what stands there."""
        at = event.get_content_offset(self)
        for row, begin, end, action in self._places:
            if at is not None and at.y == row and begin <= at.x < end:
                event.stop()
                await self.app.run_action(action)
                return


KeyOf = Callable[[str], tuple[str, bool]]
"""For an action: its key as people write it (empty: there is no such action here), and whether it can be done now."""


class KeyedLines(Lines):
    """Lines in which each value stands beside the key that changes it."""

    def __init__(self, key_of: KeyOf, *, id: str, ascii_only: bool = False) -> None:  # noqa: A002
        super().__init__(id=id, ascii_only=ascii_only)
        self._key_of = key_of

    def key(self, text: Text, action: str, words: str, style: str = "") -> Text:
        """Append ``<key> <words>``; the key is dim where the action cannot be done now, absent where there is none."""
        key, possible = self._key_of(action)
        if key:
            text.append(key, style=KEY_STYLE if possible else "dim").append(" ")
        return text.append(words, style=style)
