"""`sweepscope demo`: a whole scan on a simulated rig; with the console on a terminal, with plain lines without one."""

# ruff: noqa: PLC0415 - without a terminal Textual is not loaded

from __future__ import annotations

import dataclasses
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from acquire.contract.errors import EXIT_FAILED, NoServiceError, SweepscopeError
from acquire.contract.messaging.messages import Status
from acquire.contract.process.run_dir import is_served
from acquire.contract.scan_data.dataset_names import REPORT_NAME
from acquire.contract.scan_data.report_file import Report, read_report
from acquire.contract.states import State
from tui.client.follow import ProgressPrinter, follow_scan
from tui.client.rig_client import ProgressFeed, RigClient
from tui.console.terminal.terminal import choose_colours, is_terminal, needs_ascii, picture_mode
from tui.demo.report import DemoVerdict, is_final, report_of
from tui.demo.rig import DemoOptions, DemoRig
from tui.processes.all_services import SERVICES, read_url, say, signals_set

READY_S = 240.0
"""Longest wait for the services; the first start on a machine compiles the fold, and the machine may be slow."""
HOMING_S = 60.0
RESULTS_S = 120.0
"""Longest wait for maps and cloud after the end of the sweep."""
POLL_S = 0.1

Log = Callable[[str, str], None]
"""Takes a line and its level (``info``, ``warning`` or ``error``), from any thread."""


class CancelledError(SweepscopeError):
    """The user ended the demonstration; this is no failure."""


class Demonstration:
    """One scan, from starting the services to its report, announced step by step."""

    def __init__(
        self, rig: DemoRig, say: Callable[[str], None], on_status: Callable[[Status], None] = lambda _: None
    ) -> None:
        """``on_status`` is called with every status of the running scan."""
        self._rig, self._say, self._on_status = rig, say, on_status
        self.feed = ProgressFeed(rig.run_dir)
        self.cancelled = threading.Event()
        self.url = ""
        self.verdict: DemoVerdict | None = None

    def run(self) -> DemoVerdict:
        """Take the scan; may be called once, from any thread.

        Raises:
            CancelledError: ``cancelled`` was set meanwhile.
            SweepscopeError: a service cannot run, the scan was refused, or a time limit passed.
        """
        try:
            with self._ready_client() as client:
                self._home(client)
                name = self._rig.config.rig.simulation.object
                scan = client.request("scan", name=f"demo-{name}", specimen=f"simulated {name}").result
                self._say(f"sweep of {scan['expected']} frames into {scan['path']}")
                end = follow_scan(client, scan["scan_uid"], self._take_status)
            report = self._report(end)
            results = self.feed.end_of(end.scan_uid)
        finally:
            self.feed.close()
        self.verdict = DemoVerdict(end, report, results.seconds if results else None)
        return self.verdict

    def _take_status(self, status: Status) -> None:
        self._check()
        self.feed.newest()  # keeps the socket's queue short, also where nothing prints the progress
        self._on_status(status)

    def _check(self) -> None:
        if self.cancelled.is_set():
            raise CancelledError("cancelled; what was taken is kept")
        self._rig.check()

    def _ready_client(self) -> RigClient:
        """Wait until every service is ready; returns a client of the daemon."""
        run_dir = self._rig.run_dir
        self._say(f"starting {', '.join(SERVICES)}")
        self._wait(lambda: is_served(run_dir), READY_S, "the daemon did not come up")
        # the worker listens early but publishes only when its kernels are compiled: from then on it misses no frame
        self._wait(lambda: self.feed.newest() is not None, READY_S, "the worker did not come up")
        self._wait(lambda: bool(read_url(run_dir)), READY_S, "the viewer did not come up")
        self.url = read_url(run_dir)
        self._say(f"the cloud is shown at {self.url}")
        client = RigClient(run_dir, timeout_s=self._rig.config.rig.limits.command_s)
        try:
            self._wait(lambda: _is_ready(client.newest_status(1.0)), READY_S, "the writer did not come up")
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

    def _report(self, end: Status) -> Report:
        self._say("waiting for maps, cloud and report")
        folder = Path(end.scan_path)
        self._wait(lambda: report_of(folder) is not None, RESULTS_S, "the worker wrote no report")
        try:
            self._wait(lambda: is_final(report_of(folder), end.outcome), RESULTS_S, "the report is not final")
        except NoServiceError as error:
            self._say(str(error))
        return read_report(folder / REPORT_NAME)

    def _wait(self, ready: Callable[[], bool], limit_s: float, otherwise: str) -> None:
        end_s = time.monotonic() + limit_s
        while not ready():
            if self.cancelled.wait(POLL_S):
                self._check()
            self._rig.check(SERVICES)
            if time.monotonic() > end_s:
                raise NoServiceError(f"{otherwise} within {limit_s:g} s; see {self._rig.data_dir / 'logs'}")


def _is_ready(status: Status | None) -> bool:
    return status is not None and status.state == State.IDLE and status.writer_alive


def run_demo(options: DemoOptions) -> int:
    """Run the demonstration; returns the exit status."""
    return _run_on_terminal(options) if is_terminal() else _run_headless(options)


def _run_headless(options: DemoOptions) -> int:
    wake = threading.Event()
    with signals_set(wake) as came, DemoRig(options, _complain) as rig:
        printer = ProgressPrinter(say)
        demonstration = Demonstration(rig, say, printer.take)
        printer.progress = demonstration.feed.newest
        demonstration.cancelled = wake
        try:
            verdict = demonstration.run()
        except CancelledError as error:
            _complain(str(error))
            return 128 + int(came[0]) if came else EXIT_FAILED
    _show(verdict, demonstration.url)
    return verdict.exit_status


def _show(verdict: DemoVerdict, url: str) -> None:
    for line in verdict.lines(url):
        say(line)


def _complain(text: str) -> None:
    print(f"sweepscope demo: {text}", file=sys.stderr, flush=True)


# ---- on a terminal ----


def _run_on_terminal(options: DemoOptions) -> int:
    ascii_only = needs_ascii()
    picture = picture_mode(choose_colours("auto"), ascii_only=ascii_only)
    from tui.console.options import options_for
    from tui.console.run import run_console

    background: _DemoThread | None = None

    def begin(log: Log) -> None:
        nonlocal background
        background = _DemoThread(rig, log)

    # nothing is printed before the console starts: stderr is where it draws
    with DemoRig(options, lambda _text: None) as rig:
        console = dataclasses.replace(options_for(rig.config), owns_rig=True, ascii_only=ascii_only, picture=picture)
        status = run_console(console, run_dir=rig.run_dir, on_started=begin)
        say("ending daemon, writer, worker and viewer")
        if background is not None:
            background.end()
    return status or EXIT_FAILED if background is None else _after_console(background, status)


def _after_console(background: _DemoThread, status: int) -> int:
    demonstration = background.demonstration
    if demonstration.verdict is not None:
        _show(demonstration.verdict, demonstration.url)
        return status or demonstration.verdict.exit_status
    if demonstration.url:
        say(f"page     {demonstration.url}")
    if background.error is not None:
        raise background.error
    return status


class _DemoThread:
    """Runs the demonstration while the console is open; its steps appear in the console's log."""

    def __init__(self, rig: DemoRig, log: Log) -> None:
        self._log = log
        self.error: SweepscopeError | None = None
        self.demonstration = Demonstration(rig, lambda text: log(text, "info"))
        rig.supervisor.say = lambda text: log(text, "warning")
        self._thread = threading.Thread(target=self._run, name="demonstration", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Stop following the scan and wait for the thread."""
        self.demonstration.cancelled.set()
        self._thread.join()

    def _run(self) -> None:
        try:
            verdict = self.demonstration.run()
        except CancelledError:
            return
        except SweepscopeError as error:
            self.error = error
            self._log(str(error), "error")
            return
        for line in verdict.findings():
            self._log(line, "info")
