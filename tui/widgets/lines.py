"""A pane of styled lines that repaints only when its text or size changed."""

from __future__ import annotations

from rich.text import Text
from textual.widget import Widget


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
