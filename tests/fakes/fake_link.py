"""A console's connection without sockets: keeps what was sent, says what a test wants said."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from textual.message import Message


class FakeLink:
    """Stands in for ``tui.link.RigLink``."""

    def __init__(self, post: Callable[[Message], Any]) -> None:
        self.post = post
        self.sent: list[tuple[str, dict[str, Any]]] = []
        self.started = self.closed = False

    def start(self) -> None:
        self.started = True

    def close(self) -> None:
        self.closed = True

    def send(self, name: str, /, **args: Any) -> None:
        self.sent.append((name, args))
