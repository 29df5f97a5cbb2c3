"""What all screens share: header, fault banner, keys, and the reasons why an action cannot be done now."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Container
from textual.events import Resize
from textual.screen import Screen
from textual.widgets import Static

from tui.console.jobs import Jobs
from tui.console.link.messages import CommandAnswered
from tui.console.link.rig_view import RigView
from tui.console.shell import Shell
from tui.console.terminal.terminal import LEAST_HEIGHT, LEAST_WIDTH
from tui.console.widgets.frame import FaultBanner, Header, KeyLine, LogLastLine, Offer

WIDE = 120
"""From this width on a screen has the class ``wide``: panes may stand side by side."""


class RigScreenBase(Screen[None]):
    """A screen that is switched to by its number. A subclass has ``BINDINGS`` with ids ``<name>.<action>``,
    :meth:`body`, :meth:`show`, and where an action is not always possible :meth:`why_not`.
    """

    NAME: ClassVar[str] = ""
    """The screen's name in ``SCREENS``."""
    SUMMARY: ClassVar[str] = ""
    """One or two sentences above the list of actions in the help."""
    CHANGES: ClassVar[frozenset[str]] = frozenset()
    """Actions that move or change the rig: absent with --read-only, refused while another client has control."""
    CHANGES_FILES: ClassVar[frozenset[str]] = frozenset()
    """Actions that change scans on disk: absent with --read-only."""
    IN_PANES: ClassVar[frozenset[str]] = frozenset()
    """Ids of bindings whose keys stand in the panes: the line of keys has them last."""
    SHOWS_LOG: ClassVar[bool] = False
    """True if the body shows the log; otherwise the newest line of the log stands above the keys."""
    WANTS_PICTURES: ClassVar[bool] = False
    """True if the screen needs camera pictures while it is in view."""

    DEFAULT_CSS = """
    RigScreenBase { layout: vertical; }
    RigScreenBase #body { height: 1fr; }
    RigScreenBase #small { display: none; height: 1fr; padding: 0 1; }
    RigScreenBase.small #small { display: block; }
    RigScreenBase.small #body { display: none; }
    """

    def __init__(self, shell: Shell) -> None:
        super().__init__()
        self.shell = shell
        self._header = Header(self.NAME, read_only=shell.options.read_only)
        self._banner, self._last_line, self._key_line = FaultBanner(()), LogLastLine(None), KeyLine(())
        self.own_bindings = list(Binding.make_bindings(self.BINDINGS))
        """One binding per key."""
        self._own = frozenset(action_name(binding.action) for binding in self.own_bindings)
        self._changing = self.CHANGES | self.CHANGES_FILES

    # ---- for subclasses ----

    def body(self) -> ComposeResult:
        """The screen's own panes."""
        yield from ()

    def show(self, view: RigView) -> None:
        """Take the newest values; called with each update while this screen is in view, and when it comes into view."""

    def why_not(self, action: str) -> str:
        """Why ``action`` (a name without arguments) cannot be done now, in words; empty if it can."""
        return ""

    @property
    def view(self) -> RigView:
        """The newest values."""
        return self.shell.state.view

    @property
    def jobs(self) -> Jobs:
        """Long work in child processes."""
        return self.shell.jobs

    def send(self, name: str, /, on_answer: Callable[[CommandAnswered], None] | None = None, **args: Any) -> None:
        """Send a command to the daemon without waiting; its answer is logged, or given to ``on_answer``."""
        self.shell.send_command(name, args, on_answer)

    def say(self, text: str, level: str = "info") -> None:
        """Add a line to the log and show it."""
        self.shell.say(text, level)

    def ask(self, dialog: Screen[Any], then: Callable[[Any], Any]) -> None:
        """Open a dialog; ``then`` gets its answer, unless it was left or answered with no."""
        self.app.push_screen(dialog, lambda answer: None if answer is None or answer is False else then(answer))

    # ---- the frame around the body ----

    def compose(self) -> ComposeResult:
        """Header, banner, body, log line, keys."""
        yield self._header
        yield self._banner
        with Container(id="body"):
            yield from self.body()
        small = f"this terminal is smaller than {LEAST_WIDTH} x {LEAST_HEIGHT}: make it larger; SPACE = STOP works"
        yield Static(small, id="small")
        if not self.SHOWS_LOG:
            yield self._last_line
        yield self._key_line

    def on_resize(self, event: Resize) -> None:
        """Choose the layout."""
        self.set_class(event.size.width >= WIDE, "wide")
        self.set_class(event.size.width < LEAST_WIDTH or event.size.height < LEAST_HEIGHT, "small")

    def on_screen_resume(self) -> None:
        """Show what happened while another screen was in view."""
        if self.is_mounted:
            self.show_all(self.view)

    def show_all(self, view: RigView) -> None:
        """Frame and body."""
        self._header.show(view)
        self._banner.show(view.status.faults if view.status else [])
        if not self.SHOWS_LOG:
            self._last_line.show(next(reversed(self.shell.state.log.lines), None))
        self.show(view)
        self._key_line.show(self.offers())  # what can be done may depend on what is shown now

    # ---- actions ----

    def actions(self) -> list[Binding]:
        """Everything that this screen can ever do, for help and palette."""
        own: dict[str, Binding] = {}
        for binding in self.own_bindings:
            if binding.show and self.check_action(action_name(binding.action), ()):
                own.setdefault(binding.action, binding)  # under the first of its keys
        return [*own.values(), *self.shell.actions()]

    def offers(self) -> list[Offer]:
        """What can be done now; keys that the panes show beside a value come last."""
        possible = [binding for binding in self.actions() if not self.why_not_now(binding.action)]
        return [
            Offer(self.shell.key_label(binding), binding.description, self._addressed(binding.action))
            for binding in sorted(possible, key=lambda binding: binding.id in self.IN_PANES)
        ]

    def is_own(self, action: str) -> bool:
        """True for an action of this screen, False for one that every screen has."""
        return action_name(action) in self._own

    def _addressed(self, action: str) -> str:
        return f"{'screen' if self.is_own(action) else 'app'}.{action}"

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """False for what a read-only console does not have."""
        return not (action in self._changing and self.shell.options.read_only)

    def why_not_now(self, action: str) -> str:
        """Why ``action`` cannot be done now: no rig, another client's control, or the screen's own reason."""
        name = action_name(action)
        if name not in self._own:
            return self.shell.state.why_not(name)
        no_command = self.shell.state.why_no_command(changes=True) if name in self.CHANGES else ""
        return no_command or self.why_not(name)


def action_name(action: str) -> str:
    """``jog`` of ``screen.jog(1)``."""
    return action.partition("(")[0].rpartition(".")[2]
