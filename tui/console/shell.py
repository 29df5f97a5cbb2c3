"""What the screens ask of the console's app, and what the app asks of its connection; neither side imports the app."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from textual.binding import Binding
from textual.screen import Screen

from tui.console.jobs import Jobs
from tui.console.link.messages import Updates
from tui.console.options import ConsoleOptions
from tui.console.state.console_state import ConsoleState, OnAnswer
from tui.console.terminal.terminal_driver import OutputMeter


class RigConnection(Protocol):
    """The connection to the rig."""

    def start(self) -> None:
        """Begin to listen."""

    def close(self) -> None:
        """End."""

    def send(self, name: str, /, **args: Any) -> str:
        """Send a command without waiting; returns its request id. Safe from any thread."""

    def want_pictures(self, wanted: bool) -> None:
        """Receive camera pictures, or no longer."""


ConnectionMaker = Callable[[Callable[[Updates], Any]], RigConnection]
"""Makes a connection that posts to the given function."""


class Shell(Protocol):
    """The console as its screens see it."""

    @property
    def options(self) -> ConsoleOptions:
        """How this console was started."""

    @property
    def state(self) -> ConsoleState:
        """What is known: the rig, the next scan, log, faults."""

    @property
    def jobs(self) -> Jobs:
        """Long work in child processes."""

    @property
    def meter(self) -> OutputMeter:
        """The output to the terminal."""

    def now_s(self) -> float:
        """Monotonic time."""

    def say(self, text: str, level: str = "info") -> None:
        """Add a line to the log and show it."""

    def refresh_view(self) -> None:
        """Show what is known now; while the terminal takes no output, it is shown later."""

    def send_command(self, name: str, args: Mapping[str, Any], on_answer: OnAnswer | None = None) -> None:
        """Send a command; its answer is logged, or given to ``on_answer``."""

    def actions(self) -> list[Binding]:
        """The actions that every screen has."""

    def key_label(self, binding: Binding) -> str:
        """The key of a binding as people write it, the operator's own where there is one."""

    def screen_named(self, name: str) -> Screen[None]:
        """The screen of that name, made when it is first asked for."""

    def action_go(self, name: str) -> None:
        """Switch to a screen."""

    def ask_terminal(self) -> None:
        """Have the terminal answer once it has shown everything up to now."""
