"""A console's connection without sockets: keeps what was sent, says what a test wants said."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from textual.message import Message


class FakeLink:
    """Stands in for ``tui.console.link.rig_link.RigLink``."""

    def __init__(self, post: Callable[[Message], Any]) -> None:
        self.post = post
        self.sent: list[tuple[str, dict[str, Any]]] = []
        self.started = self.closed = False
        self.pictures_wanted = False

    def start(self) -> None:
        self.started = True

    def close(self) -> None:
        self.closed = True

    def send(self, name: str, /, **args: Any) -> str:
        self.sent.append((name, args))
        return f"request-{len(self.sent)}"

    def want_pictures(self, wanted: bool) -> None:
        self.pictures_wanted = wanted
