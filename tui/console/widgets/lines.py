"""A pane of styled lines that repaints only when its text or its size has changed.

Textual's Static repaints with each update, and a repaint is sent to the terminal whole, even where nothing changed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from rich.style import Style
from rich.text import Text
from textual.widget import Widget

from tui.text.ascii_signs import to_ascii

KEY_STYLE = "bold #f0b429"

Shown = TypeVar("Shown")


class Lines(Widget, Generic[Shown]):
    """Shows what :meth:`text_for` makes of the newest value, cut to the pane's width; in ASCII where asked for."""

    ALLOW_SELECT = False

    def __init__(self, shown: Shown) -> None:
        super().__init__()
        self.auto_links = False  # what can be clicked looks as it is written
        self.shown = shown
        self._painted: Text | None = None

    def show(self, value: Shown) -> None:
        """Take the newest value."""
        self.shown = value
        self.changed()

    def text_for(self, width: int) -> Text:
        """The lines for a pane that is ``width`` cells wide."""
        raise NotImplementedError

    def changed(self) -> None:
        """Repaint if the text is different now."""
        text = self._text()
        if text != self._painted or text.spans != (self._painted.spans if self._painted else []):
            self.refresh()

    def render(self) -> Text:
        """The text; remembered, so that nothing is painted twice."""
        self._painted = self._text()
        return self._painted

    def _text(self) -> Text:
        text = self.text_for(self.content_size.width)
        return to_ascii(text) if self.app.has_class("ascii") else text

    @property
    def plain(self) -> str:
        """The text without styles, as it would be painted now."""
        return self._text().plain


class Pane(Lines[Shown]):
    """Lines in a frame with a title."""

    DEFAULT_CSS = """
    Pane { height: 1fr; border: round $primary 60%; border-title-color: $text-muted; padding: 0 1; }
    """


def clickable(action: str) -> Style:
    """The style of text that runs an action when it is clicked (with ``--mouse``)."""
    return Style.from_meta({"@click": action})


KeyOf = Callable[[str], tuple[str, bool]]
"""For an action: its key as people write it (empty: no such action here), and whether it can be done now."""


def append_key(text: Text, key_of: KeyOf, action: str, words: str, style: str = "") -> Text:
    """Append ``<key> <words>``; the key is dim where the action cannot be done now, absent where there is none."""
    key, possible = key_of(action)
    if key:
        text.append(key, style=KEY_STYLE if possible else "dim").append(" ")
    return text.append(words, style=style)
