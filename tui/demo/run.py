"""`sweepscope demo`: a whole scan on a simulated rig, with the console on a terminal and as plain lines without one."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from acquire.contract.errors import EXIT_FAILED, NoServiceError, SweepscopeError
from acquire.contract.messaging.messages import Status
from acquire.contract.process.run_dir import is_served
from acquire.contract.states import State
from tui.client.follow import Narrator, follow_scan
from tui.client.rig_client import ProgressFeed, RigClient
from tui.console.terminal.terminal import choose_colours, is_terminal, picture_mode
from tui.demo.report import Verdict, is_final, read_report
from tui.demo.rig import DemoOptions, DemoRig
from tui.processes.all_services import SERVICES, read_url, say, signals_set

if TYPE_CHECKING:
    from tui.console.app import ConsoleApp

READY_S = 240.0
"""Longest wait for the services; the first start on a machine compiles the fold, and it may be a slow one."""
HOMING_S = 60.0
RESULTS_S = 120.0
"""Longest wait for maps and cloud after the sweep's end."""
LOOK_S = 0.1


class CancelledError(SweepscopeError):
    """The operator ended the demonstration; nothing is wrong."""


class Demonstration:
    """One scan from readiness to its report, said step by step; may be run in any thread."""

    def __init__(self, rig: DemoRig, say: Callable[[str], None], hear: Callable[[Status], None]) -> None:
        """``hear`` is called with every status of the running scan."""
        self._rig, self._say, self._hear = rig, say, hear
        self.feed = ProgressFeed(rig.run_dir)
        self.cancelled = threading.Event()
        self.url = ""

    def run(self) -> Verdict:
        """Take the scan; may be called once.

        Raises:
            CancelledError: ``cancelled`` was set meanwhile.
            SweepscopeError: a service cannot run, the scan was refused, or a deadline passed.
        """
        try:
            return self._run()
        finally:
            self.feed.close()

    def _run(self) -> Verdict:
        with self._ready() as client:
            self._home(client)
            sweep = self._rig.config.rig.simulation
            result = client.request("scan", name=f"demo-{sweep.object}", specimen=f"simulated {sweep.object}").result
            self._say(f"sweep of {result['expected']} frames into {result['path']}")
            end = follow_scan(client, result["scan_uid"], self._listen)
        report = self._report(end)
        heard = self.feed.end_of(end.scan_uid)
        return Verdict(end, report, heard.seconds if heard else None)

    def _listen(self, status: Status) -> None:
        self._check()
        self.feed.newest()  # taken off the socket in time, also where nobody prints it
        self._hear(status)

    def _check(self) -> None:
        if self.cancelled.is_set():
            raise CancelledError("cancelled; what was taken is kept")
        self._rig.check()

    def _ready(self) -> RigClient:
        """Wait until every service is there; the client of the daemon."""
        run_dir = self._rig.run_dir
        self._say(f"starting {', '.join(SERVICES)}")
        self._await(lambda: is_served(run_dir), READY_S, "the daemon did not come up")
        # it listens at once, but speaks only when its kernels are compiled: then it misses no frame
        self._await(lambda: self.feed.newest() is not None, READY_S, "the worker did not come up")
        self._await(lambda: bool(read_url(run_dir)), READY_S, "the viewer did not come up")
        self.url = read_url(run_dir)
        self._say(f"the cloud is shown at {self.url}")
        client = RigClient(run_dir, timeout_s=self._rig.config.rig.limits.command_s)
        try:
            self._await(lambda: _is_ready(client.newest_status(1.0)), READY_S, "the writer did not come up")
        except SweepscopeError:
            client.close()
            raise
        return client

    def _home(self, client: RigClient) -> None:
        if client.status().position_trusted:
            return
        self._say("homing the stage")
        client.request("home")
        if client.wait_for(lambda s: s.state == State.IDLE and s.position_trusted, HOMING_S) is None:
            raise SweepscopeError(f"the stage was not homed within {HOMING_S:g} s; see the daemon's log")

    def _report(self, end: Status) -> dict[str, object]:
        self._say("waiting for maps, cloud and report")
        folder = Verdict(end, {}).folder
        self._await(lambda: read_report(folder) is not None, RESULTS_S, "the worker wrote no report")
        try:
            self._await(lambda: is_final(read_report(folder), end.outcome), RESULTS_S, "the report is not final")
        except NoServiceError as error:
            self._say(str(error))
        return read_report(folder) or {}

    def _await(self, happened: Callable[[], bool], deadline_s: float, otherwise: str) -> None:
        end_s = time.monotonic() + deadline_s
        while not happened():
            if self.cancelled.wait(LOOK_S):
                self._check()
            self._rig.check(SERVICES)
            if time.monotonic() > end_s:
                raise NoServiceError(f"{otherwise} within {deadline_s:g} s; see {self._rig.data_dir / 'logs'}")


def _is_ready(status: Status | None) -> bool:
    return status is not None and status.state == State.IDLE and status.writer_alive


def run_demo(options: DemoOptions) -> int:
    """Run the demonstration; returns the exit status."""
    return _run_on_terminal(options) if is_terminal() else _run_headless(options)


def _run_headless(options: DemoOptions) -> int:
    wake = threading.Event()
    with signals_set(wake) as came, DemoRig(options, _complain) as rig:
        narrator = Narrator(say)
        demonstration = Demonstration(rig, say, narrator.hear)
        narrator.progress = demonstration.feed.newest
        demonstration.cancelled = wake
        try:
            verdict = demonstration.run()
        except CancelledError as error:
            _complain(str(error))
            return 128 + int(came[0]) if came else EXIT_FAILED
    _show(verdict, demonstration.url)
    return verdict.exit_status


def _show(verdict: Verdict, url: str) -> None:
    for line in verdict.lines(url):
        say(line)


def _run_on_terminal(options: DemoOptions) -> int:
    picture = picture_mode(choose_colours("auto"), ascii_only=False)
    from tui.console.app import run_console  # noqa: PLC0415 - without a terminal Textual is never loaded
    from tui.console.link.messages import Note  # noqa: PLC0415
    from tui.console.start_options import options_for  # noqa: PLC0415

    thread: _DemoThread | None = None

    def begin(app: ConsoleApp) -> None:
        nonlocal thread

        def warn(text: str) -> None:
            app.post_message(Note(text, "warning"))

        rig.supervisor.say = warn
        thread = _DemoThread(rig, app)
        thread.start()

    with DemoRig(options, _to_log) as rig:
        console = options_for(rig.config, owns_rig=True, picture=picture)
        status = run_console(console, run_dir=rig.run_dir, on_started=begin)
        say("ending daemon, writer, worker and viewer")
        if thread is not None:
            thread.end()
    return _after_console(thread, status)


def _after_console(thread: _DemoThread | None, status: int) -> int:
    if thread is None:
        return status or EXIT_FAILED
    if thread.verdict is not None:
        _show(thread.verdict, thread.demonstration.url)
        return status or thread.verdict.exit_status
    if thread.demonstration.url:
        say(f"page     {thread.demonstration.url}")
    if thread.error is not None:
        raise thread.error
    return status


class _DemoThread:
    """The demonstration beside the console: it starts the sweep and tells the console's log what it does."""

    def __init__(self, rig: DemoRig, app: ConsoleApp) -> None:
        self._app = app
        self.verdict: Verdict | None = None
        self.error: SweepscopeError | None = None
        self.demonstration = Demonstration(rig, self._note, lambda _status: None)
        self._thread = threading.Thread(target=self._run, name="demonstration", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def end(self) -> None:
        """Stop following the scan and wait for the thread."""
        self.demonstration.cancelled.set()
        self._thread.join()

    def _note(self, text: str, level: str = "info") -> None:
        from tui.console.link.messages import Note  # noqa: PLC0415

        self._app.post_message(Note(text, level))

    def _run(self) -> None:
        try:
            self.verdict = self.demonstration.run()
        except CancelledError:
            return
        except SweepscopeError as error:
            self.error = error
            self._note(str(error), "error")
            return
        for line in self.verdict.findings():
            self._note(line)


def _complain(text: str) -> None:
    print(f"sweepscope demo: {text}", file=sys.stderr, flush=True)


def _to_log(_text: str) -> None:
    """Nothing is printed before the console is there: stderr belongs to its picture."""
