"""What all screens of the console share: header, fault banner, keys, and the words for what cannot be done now."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, cast

from textual.app import ComposeResult
from textual.binding import Binding, BindingsMap
from textual.containers import Container
from textual.events import Resize
from textual.screen import Screen
from textual.widgets import Static

from tui.console.link.rig_view import RigView
from tui.console.widgets.frame import FaultBanner, Header, KeyLine, NewsLine, Offer

if TYPE_CHECKING:
    from tui.console.app import ConsoleApp
    from tui.console.link.messages import CommandAnswered

LEAST_WIDTH, LEAST_HEIGHT = 60, 20
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
    """Actions that move or change the rig: absent with --read-only, refused while somebody else holds control."""
    NEEDS_RIG: ClassVar[frozenset[str]] = frozenset()
    """Actions that need the daemon without changing anything; those of ``CHANGES`` always need it."""
    IN_PANES: ClassVar[frozenset[str]] = frozenset()
    """Ids of bindings whose keys stand in the panes: the line of keys has them last."""
    SHOWS_LOG: ClassVar[bool] = False
    """True if the body shows the log itself; otherwise the newest line of news stands above the keys."""
    WANTS_PICTURES: ClassVar[bool] = False
    """True if camera pictures shall arrive while this screen is in view."""

    DEFAULT_CSS = """
    RigScreenBase { layout: vertical; }
    RigScreenBase #body { height: 1fr; }
    RigScreenBase #small { display: none; height: 1fr; padding: 0 1; }
    RigScreenBase.small #small { display: block; }
    RigScreenBase.small #body { display: none; }
    """

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__()
        self.ascii_only = ascii_only
        self._shell: ConsoleApp | None = None
        self._frame: tuple[Header, FaultBanner, NewsLine, KeyLine] = (
            Header(self.NAME, ascii_only=ascii_only),
            FaultBanner(ascii_only=ascii_only),
            NewsLine(ascii_only=ascii_only),
            KeyLine(ascii_only=ascii_only),
        )

    def belongs_to(self, shell: ConsoleApp) -> None:
        """Said once by the console that made it."""
        self._shell = shell

    # ---- for subclasses ----

    def body(self) -> ComposeResult:
        """The screen's own panes."""
        yield from ()

    def show(self, view: RigView) -> None:
        """Take the newest values; called at each news while this screen is in view, and when it comes into view."""

    def why_not(self, action: str) -> str:
        """Why ``action`` (a name without arguments) cannot be done now, in words; empty if it can."""
        return ""

    @property
    def shell(self) -> ConsoleApp:
        """The console that this screen belongs to (also before the screen was ever in view)."""
        return self._shell if self._shell is not None else cast("ConsoleApp", self.app)

    @property
    def view(self) -> RigView:
        """The newest values."""
        return self.shell.view

    def send(self, name: str, /, on_answer: Callable[[CommandAnswered], None] | None = None, **args: Any) -> None:
        """Send a command to the daemon without waiting; its answer goes to the log, or to ``on_answer`` alone."""
        self.shell.send_command(name, args, on_answer)

    def say(self, text: str, level: str = "info") -> None:
        """A line for the log, seen at once."""
        self.shell.say(text, level)

    # ---- the frame around the body ----

    def compose(self) -> ComposeResult:
        """Header, banner, body, news, keys."""
        header, fault, news, keys = self._frame
        yield header
        yield fault
        with Container(id="body"):
            yield from self.body()
        small = f"this terminal is smaller than {LEAST_WIDTH} x {LEAST_HEIGHT}: make it larger; SPACE = STOP works"
        yield Static(small, id="small")
        if not self.SHOWS_LOG:
            yield news
        yield keys

    def on_resize(self, event: Resize) -> None:
        """Choose the layout."""
        self.set_class(event.size.width >= WIDE, "wide")
        self.set_class(event.size.width < LEAST_WIDTH or event.size.height < LEAST_HEIGHT, "small")

    def on_screen_resume(self) -> None:
        """Show what happened meanwhile."""
        if self.is_mounted:
            self.show_all(self.view)

    def show_all(self, view: RigView) -> None:
        """Frame and body."""
        header, fault, news, keys = self._frame
        header.show(view, read_only=self.shell.read_only)
        fault.show(view.status.faults if view.status else [])
        if not self.SHOWS_LOG:
            news.show(self.shell.logbook.lines)
        self.show(view)
        keys.show(self.offers())  # what can be done may depend on what is shown now

    def offers(self) -> list[Offer]:
        """What can be done now; what the panes show beside its value comes last."""
        last = {binding.action for binding in self.actions() if binding.id in self.IN_PANES}
        return [
            (self.shell.key_words(binding), binding.description, self._addressed(binding.action))
            for binding in sorted(self.actions(), key=lambda binding: binding.action in last)
            if not self.why_not_now(binding.action)
        ]

    def _addressed(self, action: str) -> str:
        if "." in action.partition("(")[0]:
            return action
        return f"{'screen' if hasattr(self, f'action_{action_name(action)}') else 'app'}.{action}"

    def actions(self) -> list[Binding]:
        """Everything that this screen can ever do, for help and palette."""
        own = [binding for binding in _shown(self._bindings) if self._exists(binding)]
        return own + [binding for binding in _shown(self.shell._bindings) if self._exists(binding)]

    def _exists(self, binding: Binding) -> bool:
        name = action_name(binding.action)
        owner = self if hasattr(self, f"action_{name}") else self.shell
        return owner.check_action(name, ()) is not False

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """False for what a read-only console does not have."""
        return not (action in self.CHANGES and self.shell.read_only)

    def why_not_now(self, action: str) -> str:
        """Why ``action`` cannot be done now: no rig, somebody else's control, or the screen's own reason."""
        name = action_name(action)
        if not hasattr(self, f"action_{name}"):
            return self.shell.why_not(name)
        if name in self.CHANGES | self.NEEDS_RIG:
            words = self.shell.why_no_command(changes=name in self.CHANGES)
            if words:
                return words
        return self.why_not(name)


def action_name(action: str) -> str:
    """``jog`` of ``screen.jog(1)``."""
    return action.partition("(")[0].rpartition(".")[2]


def _shown(bindings: BindingsMap) -> list[Binding]:
    """Each action once, under the first of its keys."""
    found: dict[str, Binding] = {}
    for _, binding in bindings:
        if binding.show and binding.description:
            found.setdefault(binding.action, binding)
    return list(found.values())
