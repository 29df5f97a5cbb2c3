"""The log: what happened, with the time of day; the newest line is in view, the number of lines is bounded."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime

from rich.text import Text
from textual.widgets import RichLog

MAX_LINES = 2000
_STYLES = {"info": "", "warning": "yellow", "error": "bold red"}


def local_time() -> str:
    """The time of day as the log shows it."""
    return datetime.now().astimezone().strftime("%H:%M:%S")


class LogPane(RichLog):
    """Lines of news; every one that was ever said in this session, up to a bound."""

    DEFAULT_CSS = """
    LogPane { height: 1fr; min-height: 3; border: round $primary; border-title-color: $text; padding: 0 1;
              background: $background; overflow-x: hidden; scrollbar-size-vertical: 1; }
    """

    def __init__(self, clock: Callable[[], str] = local_time) -> None:
        super().__init__(id="log", wrap=True, markup=False, highlight=False, max_lines=MAX_LINES, min_width=20)
        self.border_title = "log"
        self.can_focus = False
        self._clock = clock
        self.said: list[str] = []

    def say(self, text: str, level: str = "info") -> None:
        """Add a line; one that repeats the last line is left out."""
        if self.said and self.said[-1] == text:
            return
        self.said = [*self.said[-MAX_LINES:], text]
        self.write(Text(f"{self._clock()} {text}", style=_STYLES.get(level, "")))
