"""How a console is started, and what it needs of its connection."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from textual.message import Message

from tui.console.link.messages import CommandAnswered
from tui.console.state.scan_draft import Draft


class Link(Protocol):
    """What the console needs of its connection."""

    def start(self) -> None:
        """Begin to listen."""

    def close(self) -> None:
        """End."""

    def send(self, name: str, /, **args: Any) -> str:
        """Send a command without waiting; returns its request id."""

    def want_pictures(self, wanted: bool) -> None:
        """Listen to camera pictures, or no longer."""


LinkMaker = Callable[[Callable[[Message], Any]], Link]
"""Makes a connection that posts to the given function."""
OnAnswer = Callable[[CommandAnswered], None]


@dataclass(frozen=True)
class ConsoleOptions:
    """How this console was started."""

    ascii_only: bool = False
    read_only: bool = False
    """Look, but have no action that moves or changes the rig; STOP stays."""
    owns_rig: bool = False
    """The services end with this program, so leaving during a sweep is asked about."""
    me: str = ""
    """This console's name on the rig: ``anna on pts/3``."""
    screen: str = "scan"
    """The screen that is shown first."""
    draft: Draft = field(default_factory=Draft)
    """What the next scan starts from."""
    keymap: Mapping[str, str] = field(default_factory=dict)
    data_dir: Path = field(default_factory=lambda: Path("~/sweepscope-scans").expanduser())
    """Folder of all scans."""
    theme: str = "sweepscope-dark"
    mouse: bool = False
    """Let the mouse press what can be pressed; off by default: a line that drops leaves its reports on."""
    picture: str = "half"
    """``half``, ``mono`` or ``off``."""
