"""The console's log: every line of news of this session with its time, bounded; screens show parts of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

MAX_LINES = 2000
Level = Literal["info", "warning", "error"]


def local_time() -> str:
    """The time of day as the log shows it."""
    return datetime.now().astimezone().strftime("%H:%M:%S")


@dataclass(frozen=True)
class LogLine:
    """One line of news."""

    at: str
    """Local time of day."""
    level: str
    """``info``, ``warning`` or ``error``."""
    text: str


class LogBook:
    """Keeps the newest lines; counts those that it had to let go."""

    def __init__(self, clock: Callable[[], str] = local_time) -> None:
        self.lines: deque[LogLine] = deque(maxlen=MAX_LINES)
        self.said = 0
        """Lines that were ever said."""
        self._clock = clock

    def say(self, text: str, level: str = "info") -> bool:
        """Add a line; one that repeats the last line is left out (False)."""
        if self.lines and self.lines[-1].text == text:
            return False
        self.lines.append(LogLine(self._clock(), level, text))
        self.said += 1
        return True
