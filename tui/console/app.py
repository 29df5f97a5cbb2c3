"""The console's app: a client of the daemon that shows and steers the rig; its end never touches a sweep.

It starts and ends the connection, handles the keys that mean the same everywhere, STOP first, and switches screens.
What is known of the rig is in ``state``, what can be done in ``screens``, the terminal's link in ``terminal``.
"""

from __future__ import annotations

import asyncio
import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from textual import events
from textual.app import App
from textual.binding import Binding
from textual.dom import DOMNode

from acquire.contract.permissions import PERMISSIONS
from tui.console.jobs import Jobs
from tui.console.keys import APP_BINDINGS, QUIT_ENDS_RIG, STOP_KEY, TYPING_STOP_KEY
from tui.console.link.messages import LogMessage, Updates
from tui.console.options import ConsoleOptions
from tui.console.screen_table import SCREENS
from tui.console.screens.actions import ActionList
from tui.console.screens.base import RigScreenBase, action_name
from tui.console.screens.dialogs import Confirm, Dialog
from tui.console.screens.registry import screen_class
from tui.console.shell import ConnectionMaker, RigConnection
from tui.console.state.console_state import ConsoleState, OnAnswer
from tui.console.state.session_log import local_time
from tui.console.terminal.terminal_driver import ConsoleDriver, OutputMeter
from tui.console.terminal.themes import THEMES
from tui.text.status_text import is_running, newest_fault

POLL_S = 0.5
"""How often the terminal's link is checked."""
RENEW_CONTROL_S = 3.0
"""Control lapses 10 s after the holder's last message."""


class ConsoleApp(App[None]):
    """Screens over one rig."""

    TITLE = "sweepscope"
    ENABLE_COMMAND_PALETTE = False
    CSS = """
    .ascii PicturePane, .ascii Pane, .ascii Dialog > Vertical { border: ascii $primary 60%; }
    """
    BINDINGS = [*APP_BINDINGS]

    def __init__(
        self,
        connect: ConnectionMaker,
        options: ConsoleOptions = ConsoleOptions(),  # noqa: B008 - frozen
        *,
        clock: Callable[[], str] = local_time,
        now_s: Callable[[], float] = time.monotonic,
        on_started: Callable[[Callable[[str, str], None]], None] | None = None,
        driver_class: type | None = None,
    ) -> None:
        super().__init__(driver_class=driver_class)
        self.options = options
        self.now_s = now_s
        self.state = ConsoleState(options.me, options.next_scan, clock)
        self.jobs = Jobs(self.say, self.refresh_view, self.call_later)
        self.meter = OutputMeter()
        self.typed_ahead: set[events.Key] = set()
        """Spaces that may belong to a text whose dialog is not open yet, until the event loop takes them."""
        self._rig: RigConnection = connect(self.post_message)
        self._on_started = on_started
        self._screens: dict[str, RigScreenBase] = {}
        self._is_stale = False
        self.set_class(options.ascii_only, "ascii")
        for theme in THEMES:
            self.register_theme(theme)
        self.theme = options.theme
        self.set_keymap(dict(options.keymap))

    # ---- start and end ----

    def on_mount(self) -> None:
        """Show the first screen, then listen."""
        if not isinstance(self._driver, ConsoleDriver):
            self.meter.rate.deaf = True  # a test without a terminal: nobody answers
        self.action_go(self.options.screen)
        for number in (signal.SIGTERM, signal.SIGHUP):
            self._leave_on(number)
        self.set_interval(RENEW_CONTROL_S, self._renew_control)
        self.set_interval(POLL_S, self._poll_terminal)
        self._rig.start()
        if self._on_started is not None:
            self._on_started(self.post_log)

    def _leave_on(self, number: signal.Signals) -> None:
        try:
            asyncio.get_running_loop().add_signal_handler(number, self.exit)
        except (RuntimeError, ValueError):  # not the main thread, which handles the signals
            return

    def _poll_terminal(self) -> None:
        """Show what had to wait for the terminal, and the measured rate of its link."""
        if self.meter.wants_bare():
            self._ask_terminal(picture=False)
        words = self.meter.words() if self.meter.rate.answers else ""
        if self._is_stale or words != self.state.view.link_words:
            self.state.view = replace(self.state.view, link_words=words)
            self.refresh_view()

    def ask_terminal(self) -> None:
        """Have the terminal answer once it has shown everything up to the picture that was just painted."""
        self._ask_terminal(picture=True)

    def _ask_terminal(self, *, picture: bool) -> None:
        if isinstance(self._driver, ConsoleDriver):
            self._driver.ask(picture=picture)

    async def on_unmount(self) -> None:
        """End the input thread and the child processes."""
        self._rig.close()
        await self.jobs.close()

    # ---- what is shown ----

    def say(self, text: str, level: str = "info") -> None:
        """Add a line to the log and show it."""
        if self.state.log.say(text, level):
            self.refresh_view()

    def post_log(self, text: str, level: str) -> None:
        """The same from any thread."""
        self.post_message(LogMessage(text, level))

    def on_log_message(self, message: LogMessage) -> None:
        """A line from another thread."""
        self.say(message.text, message.level)

    def on_updates(self, message: Updates) -> None:
        """Everything that came since the last bundle, shown in one go."""
        message.taken()
        for part in message.parts:
            self.state.take(part)
        self.refresh_view()

    @property
    def rig_screen(self) -> RigScreenBase | None:
        """The screen in view, or the one beneath the dialogs; None before the first is there."""
        return next((screen for screen in reversed(self.screen_stack) if isinstance(screen, RigScreenBase)), None)

    def refresh_view(self) -> None:
        """Show what is known now; while the terminal takes no output, it is shown later."""
        self._is_stale = self.meter.stalled()
        if not self.screen_stack or self._is_stale:
            return
        screen = self.rig_screen
        if screen is not None and screen.is_mounted:
            with self.batch_update():
                screen.show_all(self.state.view)

    # ---- commands and actions ----

    def send_command(self, name: str, args: Mapping[str, Any], on_answer: OnAnswer | None = None) -> None:
        """Send a command; a read-only console sends none that changes anything."""
        if self.options.read_only and not PERMISSIONS[name].for_observers:
            self.say(f"{name}: this console is read-only", "warning")
            return
        request_id = self._rig.send(name, **args)
        if on_answer is not None:
            self.state.expect_answer(request_id, on_answer)

    def actions(self) -> list[Binding]:
        """The actions that every screen has, with what leaving means here."""
        shown = [binding for binding in APP_BINDINGS if binding.show and self.check_action(binding.action, ())]
        if not self.options.owns_rig:
            return shown
        return [replace(found, tooltip=QUIT_ENDS_RIG) if found.action == "quit" else found for found in shown]

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """A read-only console cannot take control, nor acknowledge a fault."""
        return not (action in ("control", "acknowledge") and self.options.read_only)

    async def run_action(
        self, action: Any, default_namespace: DOMNode | None = None, namespaces: Mapping[str, DOMNode] | None = None
    ) -> bool:
        """Do an action, or say why it cannot be done now."""
        screen, name = self.screen, action if isinstance(action, str) else action[1]
        if isinstance(screen, RigScreenBase) and (default_namespace is self or default_namespace is screen):
            words = screen.why_not_now(name)
            if words:
                self.say(f"{action_name(name)}: {words}", "warning")
                return True
        return await super().run_action(action, default_namespace, namespaces)

    def key_label(self, binding: Binding) -> str:
        """The key of a binding as people write it, the operator's own where there is one."""
        keys = self.options.keymap.get(binding.id or "", binding.key)
        return self.get_key_display(binding.with_key(keys.split(",")[0].strip())).replace("⏎", "Enter")

    # ---- keys ----

    async def on_event(self, event: events.Event) -> None:
        """STOP before anything else sees the key: Textual's priority bindings give way to a field that takes text."""
        if isinstance(event, events.Key) and not event.is_forwarded:
            if event in self.typed_ahead:
                self.typed_ahead.discard(event)  # it goes the way of the letters before it, behind what they open
            elif self.means_stop(event.key):
                self.action_stop()
                return
            if isinstance(self.screen, Dialog) and not self.screen.may_take(event.key, self.now_s()):
                return
        await super().on_event(event)

    def means_stop(self, key: str) -> bool:
        """True if this key is STOP now; in a dialog with fields for text the space bar is not. Any thread may ask."""
        if key != STOP_KEY:
            return key == TYPING_STOP_KEY
        screen = self.screen_stack[-1] if self.screen_stack else None
        return not (isinstance(screen, Dialog) and screen.TAKES_TEXT)

    def stop_early(self) -> None:
        """Send STOP from the thread that reads the keys, even while nothing can be painted; the key itself follows."""
        self.state.stop.sent_early()
        self._rig.send("stop")

    def action_stop(self) -> None:
        """End all motion."""
        if self.state.stop.pressed():
            self._rig.send("stop")
        self.state.view = replace(self.state.view, stop_words=self.state.stop.words)
        self.refresh_view()

    def action_space_typed_ahead(self) -> None:
        """A space behind letters: STOP, unless they have opened a dialog for text meanwhile."""
        if self.means_stop(STOP_KEY):
            self.action_stop()

    def action_go(self, name: str) -> None:
        """Switch to a screen."""
        screen = self.screen_named(name)
        if self.rig_screen is screen:
            return
        if self.rig_screen is None:
            self.push_screen(screen)
        else:
            self.switch_screen(screen)
        self._rig.want_pictures(screen.WANTS_PICTURES)

    def screen_named(self, name: str) -> RigScreenBase:
        """The screen of that name, made when it is first asked for."""
        if name not in self._screens:
            self._screens[name] = screen_class(name)(self)
            self.install_screen(self._screens[name], name)
        return self._screens[name]

    def action_acknowledge(self) -> None:
        """Take the newest fault off the banner."""
        status = self.state.view.status
        fault = newest_fault(status.faults) if status else None
        if fault is not None:
            self.send_command("acknowledge", {"code": fault.code})

    def action_control(self) -> None:
        """Take control, or release it."""
        self.send_command("control", {"action": "release" if self.state.has_control else "take"})

    def _renew_control(self) -> None:
        if self.state.view.connected and self.state.has_control:
            self.send_command("control", {"action": "renew"}, lambda _answer: None)

    def action_theme(self) -> None:
        """The next colours."""
        names = [theme.name for theme in THEMES]
        here = names.index(self.theme) if self.theme in names else -1
        self.theme = names[(here + 1) % len(names)]
        self.say(f"colours: {self.theme.removeprefix('sweepscope-')}")

    def action_help(self) -> None:
        """What can be done on this screen."""
        if isinstance(self.screen, RigScreenBase):
            self.push_screen(ActionList.of_screen(self.screen), self._run_chosen)

    def action_palette(self) -> None:
        """What can be done on any screen."""
        if isinstance(self.screen, RigScreenBase):
            others = [self.screen_named(entry.name) for entry in SCREENS if entry.name != self.screen.NAME]
            self.push_screen(ActionList.of_all(self.screen, others), self._run_chosen)

    def _run_chosen(self, chosen: tuple[str, str] | None) -> None:
        """Run the chosen action on its screen; an empty screen name means the console's own actions."""
        if chosen is None:
            return
        name, action = chosen
        if name:
            self.action_go(name)
        self.call_later(self.run_action, action, self._screens[name] if name else self)

    async def action_quit(self) -> None:
        """Leave; asked first if a sweep, or work on files, would end with this program."""
        question: Confirm | None = None
        if self.options.owns_rig and is_running(self.state.view.status):
            lines = [
                "A sweep is running, and it ends with this demonstration.",
                "The frames taken so far are kept; the scan is closed as aborted and cannot go on.",
            ]
            question = Confirm(lines, "end it and leave", no="stay")
        elif self.jobs.work:
            titles = [f"- {job.title}" for job in self.jobs.work]
            lines = ["This work is running and ends with the console; it can be started again:", *titles]
            question = Confirm(lines, "end it and leave")
        if question is None:
            self.exit()
        elif not isinstance(self.screen, Confirm):
            self.push_screen(question, lambda leave: self.exit() if leave else None)
