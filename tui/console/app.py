"""The console: a client of the daemon that shows the rig and steers it; its end never touches a sweep.

It is long because Textual hands all news, keys and actions to this one object. What can be decided without it stands
elsewhere: what news means (`narration`, `fault_book`), STOP (`stopping`), jobs (`job_desk`), commands (`link`), the
terminal's link (`driver`), and what each screen can do.
"""

from __future__ import annotations

import asyncio
import signal
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from textual import events
from textual.app import App
from textual.binding import Binding
from textual.dom import DOMNode
from textual.message import Message

from acquire.contract.permissions import PERMISSIONS, needs_control
from tui.console.job_runner import JobDesk
from tui.console.keys.keynames import key_name
from tui.console.link.messages import (
    CommandAnswered,
    JobChanged,
    LinkChanged,
    MapsArrived,
    Note,
    PageKnown,
    PictureArrived,
    ProgressArrived,
    ResultsOnDisk,
    StatusArrived,
    Updates,
)
from tui.console.link.rig_view import RigView
from tui.console.options import ConsoleOptions, Link, LinkMaker, OnAnswer
from tui.console.screen_table import SCREENS
from tui.console.screens.actions import ActionList
from tui.console.screens.base import RigScreenBase, action_name
from tui.console.screens.dialogs import Confirm, ConfirmQuit, Dialog
from tui.console.state.fault_log import FaultBook
from tui.console.state.log_messages import Narrator
from tui.console.state.logbook import LogBook, local_time
from tui.console.state.stop_state import StopWatch
from tui.console.terminal.terminal_driver import ConsoleDriver, Meter
from tui.console.themes import THEMES
from tui.text.status_text import is_running, newest_fault

STOP_KEY = "space"
LOOK_S = 0.5
RENEW_CONTROL_S = 3.0
"""Control lapses 10 s after the holder's last word."""


class ConsoleApp(App[None]):
    """Screens over one rig."""

    TITLE = "sweepscope"
    ENABLE_COMMAND_PALETTE = False
    CSS = """
    .ascii PicturePane, .ascii LogTail, .ascii StagePane, .ascii LightPane, .ascii PlanPane, .ascii ProgressPane,
    .ascii .pane, .ascii Dialog > Vertical { border: ascii $primary 60%; }
    """
    BINDINGS = [
        *[
            Binding(str(number), f"go('{entry.name}')", entry.name, show=False, tooltip=entry.words)
            for number, entry in enumerate(SCREENS, 1)
        ],
        Binding("a", "acknowledge", "acknowledge", id="acknowledge", tooltip="take the newest fault off the banner"),
        Binding("T", "control", "control", id="control", tooltip="take control of the rig, or give it back"),
        Binding("colon", "palette", "actions", id="palette", tooltip="all actions of all screens (also ctrl+p)"),
        Binding("ctrl+p", "palette", "actions", show=False),
        Binding("ctrl+t", "theme", "colours", id="theme", tooltip="next colours: dark, light, high contrast"),
        Binding("q", "quit", "quit", id="quit", tooltip="leave; a sweep goes on without this screen"),
        Binding("question_mark", "help", "help", show=False, id="help"),
    ]

    def __init__(
        self,
        make_link: LinkMaker,
        options: ConsoleOptions = ConsoleOptions(),  # noqa: B008 - frozen
        *,
        clock: Callable[[], str] = local_time,
        now_s: Callable[[], float] = time.monotonic,
        on_started: Callable[[ConsoleApp], None] | None = None,
        driver_class: type | None = None,
    ) -> None:
        super().__init__(driver_class=driver_class)
        self.options = options
        self.now_s = now_s
        self.read_only = options.read_only
        self.draft = options.draft
        self.logbook = LogBook(clock)
        self.fault_book = FaultBook()
        self.jobs = JobDesk(self)
        self.view = RigView(me=options.me)
        self.meter = Meter()
        """What the terminal's link carries."""
        self._link = make_link(self.post_message)
        self._on_started = on_started
        self._screens: dict[str, RigScreenBase] = {}
        self._answers: dict[str, OnAnswer] = {}
        self._stop = StopWatch()
        self._narrator = Narrator()
        self._unshown = False
        if options.owns_rig:
            self._say_that_leaving_ends_the_rig()
        self.set_class(options.ascii_only, "ascii")
        for theme in THEMES:
            self.register_theme(theme)
        self.theme = options.theme
        self.set_keymap(dict(options.keymap))

    def _say_that_leaving_ends_the_rig(self) -> None:
        """The help of the key must be true here as well."""
        words = "leave, which ends the rig; a sweep would end with it, so it asks first"
        (binding,) = self._bindings.key_to_bindings["q"]
        self._bindings.key_to_bindings["q"] = [replace(binding, tooltip=words)]

    # ---- life ----

    def on_mount(self) -> None:
        """Show the screen, then listen."""
        if not isinstance(self._driver, ConsoleDriver):
            self.meter.governor.deaf = True  # nobody there to answer
        self.action_go(self.options.screen)
        for number in (signal.SIGTERM, signal.SIGHUP):
            self._leave_on(number)
        self.set_interval(RENEW_CONTROL_S, self._renew_control)
        self.set_interval(LOOK_S, self._look)
        self._link.start()
        if self._on_started is not None:
            self._on_started(self)

    def _leave_on(self, number: signal.Signals) -> None:
        try:
            asyncio.get_running_loop().add_signal_handler(number, self.exit)
        except (RuntimeError, ValueError):  # not the main thread: somebody else minds the signals
            return

    def _look(self) -> None:
        """Show what had to wait for the terminal, and what the terminal's link carries."""
        if self.meter.wants_bare():
            self.ask_terminal(picture=False)
        words = self.meter.words() if self.meter.governor.answers else ""
        if self._unshown or words != self.view.link_words:
            self.refresh_view(link_words=words)

    def ask_terminal(self, *, picture: bool = True) -> None:
        """Let the terminal say when it has taken everything so far."""
        if isinstance(self._driver, ConsoleDriver):
            self._driver.ask(picture=picture)

    def on_unmount(self) -> None:
        """End the input thread, and what runs in child processes."""
        self._link.close()
        self.jobs.close()

    def say(self, text: str, level: str = "info") -> None:
        """A line for the log."""
        if self.logbook.say(text, level):
            self.refresh_view()

    @property
    def rig_screen(self) -> RigScreenBase | None:
        """The screen in view, or the one beneath the dialogs; None before the first is there."""
        return next((screen for screen in reversed(self.screen_stack) if isinstance(screen, RigScreenBase)), None)

    def refresh_view(self, **changes: Any) -> None:
        """Change what is known and show it; while the terminal takes nothing, it is shown later."""
        if changes:
            self.view = replace(self.view, **changes)
        self._unshown = self.meter.stalled()
        if not self.screen_stack or self._unshown:
            return
        screen = self.rig_screen
        if screen is not None and screen.is_mounted:
            screen.show_all(self.view)

    # ---- news ----

    def on_updates(self, message: Updates) -> None:
        """Everything that came since the last bundle, in one go."""
        message.taken()
        with self.batch_update():
            for part in message.parts:
                getattr(self, part.handler_name)(part)

    def on_status_arrived(self, message: StatusArrived) -> None:
        """The newest state."""
        self.fault_book.take(message.status.faults)
        before = self.view.status
        self.view = replace(self.view, status=message.status)
        for text, level in self._narrator.said(before, message.status):
            self.say(text, level)
        stopped = self._stop.judge(message.status)
        if stopped:
            self.say(stopped)
        self.refresh_view(stop_words=self._stop.words)

    def on_progress_arrived(self, message: ProgressArrived) -> None:
        """The worker's news."""
        for text, level in self._narrator.worker_said(message.progress):
            self.say(text, level)
        self.refresh_view(progress=message.progress)

    def on_picture_arrived(self, message: PictureArrived) -> None:
        """A camera picture."""
        self.refresh_view(picture=message.picture)

    def on_maps_arrived(self, message: MapsArrived) -> None:
        """Sampled maps."""
        self.refresh_view(maps=message.maps)

    def on_results_on_disk(self, message: ResultsOnDisk) -> None:
        """A cloud is there."""
        result = message.result
        if result.cloud_path:
            self.say(f"{result.points} points in {result.cloud_path} ({result.seconds:.2f} s after the last frame)")
        elif result.message:
            self.say(f"no cloud: {result.message}", "warning")
        self.refresh_view(end=result)

    def on_link_changed(self, message: LinkChanged) -> None:
        """The daemon is heard, or not."""
        self.view = replace(self.view, connected=message.connected)
        if message.connected:
            self.say(f"connected to the rig in {message.detail}")
        else:
            self.say(f"not connected - retrying: {message.detail}", "warning")
        self.refresh_view()

    def on_command_answered(self, message: CommandAnswered) -> None:
        """What became of a command."""
        on_answer = self._answers.pop(message.request_id, None)
        if message.name == "stop":
            self._stop.answered(ok=message.ok, at_mono_ns=message.at_mono_ns)
        if on_answer is not None:
            on_answer(message)
        elif not message.ok:
            self.say(f"{message.name}: {message.detail}", "error")
        elif message.name != "stop":
            self.say(f"{message.name}: {message.detail or 'done'}")
        self.refresh_view(stop_words=self._stop.words)

    def on_page_known(self, message: PageKnown) -> None:
        """The address of the page."""
        self.refresh_view(url=message.url)

    def on_job_changed(self, message: JobChanged) -> None:
        """A child process is further, or has ended."""
        self.jobs.heard(message.job)

    def on_note(self, message: Note) -> None:
        """A line from elsewhere in this process."""
        self.say(message.text, message.level)

    # ---- commands ----

    def send_command(self, name: str, args: Mapping[str, Any], on_answer: OnAnswer | None = None) -> None:
        """Send a command; a read-only console sends none that changes anything."""
        if self.read_only and not PERMISSIONS[name].for_observers:
            self.say(f"{name}: this console is read-only", "warning")
            return
        request_id = self._link.send(name, **args)
        if on_answer is not None:
            self._answers[request_id] = on_answer

    def want_pictures(self, wanted: bool) -> None:
        """Listen to camera pictures, or no longer."""
        self._link.want_pictures(wanted)

    def why_no_command(self, *, changes: bool) -> str:
        """Why nothing can be asked of the rig now (``changes``: nothing that changes it); empty if it can."""
        if not self.view.connected or self.view.status is None:
            return "not connected"
        if changes and not self.view.in_control:
            return f"{self.view.status.control} holds control: T takes it"
        return ""

    def why_not(self, action: str) -> str:
        """Why one of the console's own actions cannot be done now; empty if it can."""
        status = self.view.status
        if action == "acknowledge" and (status is None or newest_fault(status.faults) is None):
            return "there is no fault"
        if action in ("acknowledge", "control"):
            return self.why_no_command(changes=needs_control(action))
        return ""

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """A read-only console has no control to take, and lets no rig out of a fault."""
        return not (action in ("control", "acknowledge") and self.read_only)

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

    def key_words(self, binding: Binding) -> str:
        """The key of a binding as people write it, the operator's own where there is one."""
        keys = self.options.keymap.get(binding.id or "", binding.key)
        return key_name(keys.split(",")[0].strip())

    # ---- keys ----

    async def on_event(self, event: events.Event) -> None:
        """STOP before anything else sees the key: Textual's priority bindings give way to a field that takes text."""
        if isinstance(event, events.Key) and not event.is_forwarded:
            if event.key == STOP_KEY:
                self.action_stop()
                return
            if isinstance(self.screen, Dialog) and not self.screen.may_take(event.key, self.now_s()):
                return
        await super().on_event(event)

    def stop_early(self) -> None:
        """Send STOP from the thread that reads the keys, even while nothing can be painted; the key itself follows."""
        self._stop.sent_early()
        self._link.send("stop")

    def action_stop(self) -> None:
        """End all motion."""
        if self._stop.pressed():
            self._link.send("stop")
        self.say("STOP sent; waiting for the rig's own word", "warning")
        self.refresh_view(stop_words=self._stop.words)

    def action_go(self, name: str) -> None:
        """Switch to a screen."""
        screen = self.screen_named(name)
        if self.rig_screen is screen:
            return
        if self.rig_screen is None:
            self.push_screen(screen)
        else:
            self.switch_screen(screen)
        self._link.want_pictures(screen.WANTS_PICTURES)

    def screen_named(self, name: str) -> RigScreenBase:
        """The screen of that name, made if it was never looked at."""
        if name not in self._screens:
            entry = next(entry for entry in SCREENS if entry.name == name)
            screen = self._screens[name] = entry.make(ascii_only=self.options.ascii_only)
            screen.belongs_to(self)
            self.install_screen(screen, name)
        return self._screens[name]

    def action_acknowledge(self) -> None:
        """Take the newest fault off the banner."""
        fault = newest_fault(self.view.status.faults) if self.view.status else None
        if fault is not None:
            self.send_command("acknowledge", {"code": fault.code})

    def action_control(self) -> None:
        """Take control, or give it back."""
        mine = self.view.status is not None and self.view.status.control == self.view.me and bool(self.view.me)
        self.send_command("control", {"action": "release" if mine else "take"})

    def _renew_control(self) -> None:
        status = self.view.status
        if self.view.connected and status is not None and status.control and status.control == self.view.me:
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
            self.push_screen(ActionList.of_all(self, self.screen), self._run_chosen)

    async def _run_chosen(self, chosen: tuple[str, str] | None) -> None:
        if chosen is None:
            return
        name, action = chosen
        if name:
            self.action_go(name)
        screen = self._screens[name] if name else None
        self.call_later(self.run_action, action, self if screen is None or name == "" else screen)

    async def action_quit(self) -> None:
        """Leave; asked first if a sweep, or work on files, would end with this program."""
        question: Confirm | None = None
        if self.options.owns_rig and is_running(self.view.status):
            question = ConfirmQuit()
        elif self.jobs.work:
            titles = [f"- {job.title}" for job in self.jobs.work]
            question = Confirm(
                ["This runs, and ends with the console; it can be begun again:", *titles], "end and leave"
            )
        if question is None:
            self.exit()
        elif not isinstance(self.screen, Confirm):
            self.push_screen(question, lambda leave: self.exit() if leave else None)


def run_console(
    options: ConsoleOptions = ConsoleOptions(),  # noqa: B008 - frozen
    *,
    run_dir: Path | None = None,
    command_timeout_s: float = 5.0,
    on_started: Callable[[ConsoleApp], None] | None = None,
) -> int:
    """Run the console on this terminal until the operator leaves; returns the exit status."""
    from tui.console.link.rig_link import RigLink  # noqa: PLC0415 - tests run the console without sockets
    from tui.console.terminal.terminal import prepare_terminal  # noqa: PLC0415

    def make_link(post: Callable[[Message], Any]) -> Link:
        return RigLink(post, run_dir=run_dir, command_timeout_s=command_timeout_s, client=options.me)

    prepare_terminal()
    app = ConsoleApp(make_link, options, on_started=on_started, driver_class=ConsoleDriver)
    if run_dir is not None:
        app.jobs.board.environ["SWEEPSCOPE_RUN"] = str(run_dir)
    app.run(mouse=options.mouse)
    if app.return_code:
        print("the console ended by an error; if the terminal looks odd, type: reset", file=sys.stderr)
    return app.return_code or 0
