"""Owns the viewer process: lock, page, feed and commands; puts news on the page in turns until it is told to end."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import FrameType

from acquire.contract.config.load import LoadedConfig
from acquire.contract.files import replace_file
from acquire.contract.process.clocks import MonotonicClock
from acquire.contract.process.logs import is_journal
from acquire.contract.process.notify import Notifier
from acquire.contract.process.run_dir import lock_service, prepare_run_dir
from process.viewer.panels.camera_panel import CameraPanel
from process.viewer.panels.measuring import Measuring
from process.viewer.panels.rig_panel import RigPanel
from process.viewer.panels.scans_panel import ScansPanel
from process.viewer.panels.status_panel import Panel
from process.viewer.panels.view_panel import ViewPanel
from process.viewer.rig_client.commands import CommandThread
from process.viewer.rig_client.feed import FeedThread, Snapshot
from process.viewer.scene.scene import RigShown, Scene
from process.viewer.server.access_control import Gate
from process.viewer.server.guarded_server import Page, close_page, listen, open_page
from process.viewer.stream.colouring import Look

TURN_S = 0.04
"""Least time between two turns: the words on the page are never older than this and a little."""
PICTURE_NS = 500_000_000
"""Least time between two changes of the picture: drawing is what keeps a browser from showing newer words."""
BEAT_S = 0.5
"""Longest time between two turns, for the clock and the ages on the page."""
URL_FILE = "viewer.url"


def run_viewer(
    config: LoadedConfig, run_dir: Path, *, port: int | None = None, on_ready: Callable[[str], None] | None = None
) -> None:
    """Serve the page until SIGTERM or SIGINT.

    Args:
        config: host, port and budget of points (``[viewer]``), time-out of commands (``limits.command_s``).
        run_dir: directory of the sockets; ``viewer.lock`` and ``viewer.url`` are made in it.
        port: instead of ``viewer.port``; 0 takes any free one.
        on_ready: called with the page's address once it is served.

    Raises:
        AlreadyRunningError: another viewer holds the lock.
        ConfigError: the port is taken, or the run directory cannot be used.
        GuardError: the page would be open to strangers.
    """
    stop = threading.Event()
    wake = threading.Event()
    lock = lock_service(prepare_run_dir(run_dir), "viewer")
    try:
        with _ending_on_signals(stop, wake), Viewer(config, run_dir, wake, port=port) as viewer:
            announce(viewer.url, run_dir)
            if on_ready is not None:
                on_ready(viewer.url)
            viewer.run(stop)
    finally:
        (run_dir / URL_FILE).unlink(missing_ok=True)
        lock.release()


class Viewer:
    """The page with everything behind it; a context manager that leaves no thread."""

    def __init__(self, config: LoadedConfig, run_dir: Path, wake: threading.Event, *, port: int | None = None) -> None:
        settings = config.rig.viewer
        self._clock = MonotonicClock()
        self._wake = wake
        self._gate = Gate(settings.host)
        listener = listen(settings.host, settings.port if port is None else port)
        self._page: Page = open_page(self._gate, listener, max_bytes_per_s=settings.max_bytes_per_s)
        self.url = address(self._gate, self._page.get_port())
        view_only = self._gate.view_only
        self._controls: RigPanel | None = None
        self._view: ViewPanel | None = None
        self._measuring: Measuring | None = None
        self._camera: CameraPanel | None = None
        self._scans: ScansPanel | None = None
        self._watching = False
        self._panel = Panel(self._page, view_only=view_only)
        self._commands = None if view_only else CommandThread(run_dir, config.rig.limits.command_s, wake.set)
        if self._commands is not None:
            self._controls = RigPanel(self._page, self._commands)
        tabs = None if view_only else self._page.gui.add_tab_group()
        if tabs is not None and self._controls is not None:
            with tabs.add_tab("Rig"):
                self._controls.fill()
        look = Look(max_points=settings.max_points)
        self._scene = Scene(self._page, look, self._clock, config.rig.reconstruct.calibration)
        if tabs is not None:
            with tabs.add_tab("View"):
                self._view = ViewPanel(self._page, self._scene.framing, settings.max_points)
            with tabs.add_tab("Camera"):
                self._camera = CameraPanel(self._page)
            with tabs.add_tab("Measure"):
                self._measuring = Measuring(self._page, self._scene.cloud, wake.set)
            with tabs.add_tab("Scans"):
                self._scans = ScansPanel(self._page, config.data_dir, self._scene.delivery, wake.set)
        self._feed = FeedThread(run_dir, wake, self._clock)
        self._pictured_ns = 0

    def __enter__(self) -> Viewer:
        self._turn()
        self._feed.start()
        if self._commands is not None:
            self._commands.start()
        self._gate.arm()
        return self

    def __exit__(self, *_: object) -> None:
        self._feed.close()
        if self._commands is not None:
            self._commands.close()
        close_page(self._page)
        if self._scans is not None:
            self._scans.close()

    def run(self, stop: threading.Event) -> None:
        """Put news on the page until ``stop`` is set (and ``wake`` with it)."""
        notifier = Notifier()
        notifier.ready("the page is served")
        while not stop.is_set():
            self._wake.wait(TURN_S if self._scene.delivery.pending else BEAT_S)
            self._wake.clear()
            self._turn()
            notifier.alive()
            stop.wait(TURN_S)

    def _turn(self) -> None:
        now_ns = self._clock.now_ns()
        snapshot = self._feed.snapshot()
        if now_ns - self._pictured_ns >= PICTURE_NS:
            self._pictured_ns = now_ns
            self._draw(snapshot, now_ns)
        if self._view is not None:
            self._scene.look(self._view.look, now_ns)
        if self._measuring is not None and self._scans is not None:
            self._measuring.forget(self._scans.title)
            self._measuring.turn(self._scans.pickable, self._scene.eye_mm)
        self._scene.delivery.turn(now_ns)
        opened = self._scans.opened if self._scans is not None else None
        facts = self._scene.facts
        self._panel.show(snapshot, now_ns, replace(facts, opened=opened.entry.label) if opened else facts)
        if self._controls is not None:
            self._controls.show(snapshot, now_ns)

    def _draw(self, snapshot: Snapshot, now_ns: int) -> None:
        """What costs a browser something: points, picture, lines."""
        watched = bool(self._page.get_clients())
        self._watch(watched)
        news, opened = self._feed.take_tiles(), None
        if self._scans is not None:
            self._scans.turn(snapshot, now_ns, watched=watched)
            news = self._scans.news(news)
            opened = self._scans.opened.entry.folder if self._scans.opened is not None else None
        pixels = self._feed.take_pixels()
        shown = self._camera.shown if self._camera is not None else RigShown()
        self._scene.show(snapshot, news, pixels, shown, opened)
        if self._camera is not None:
            self._camera.show(snapshot, now_ns, pixels)
        if self._view is not None:
            self._view.show(self._scene.cloud)

    def _watch(self, wanted: bool) -> None:
        """Camera pictures only while somebody looks at the page."""
        if wanted != self._watching:
            self._watching = wanted
            self._feed.watch(wanted)


def address(gate: Gate, port: int) -> str:
    """The address with the token, as it is printed."""
    host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(gate.bound_host, gate.bound_host)  # noqa: S104
    if ":" in host and not host.startswith("["):
        host = f"[{host}]"
    return f"http://{host}:{port}/?token={gate.token}"


def announce(url: str, run_dir: Path) -> None:
    """Print the address on a line of its own, and leave it in ``viewer.url``, for those who may use the sockets."""
    target = run_dir / URL_FILE
    mode = 0o640 if run_dir.stat().st_mode & 0o010 else 0o600
    replace_file(target, f"{url}\n".encode("ascii"), mode=mode)
    # what stands in the journal is read by more people than the file is
    print(f"the address of the page is in {target}" if is_journal(sys.stdout) else url, flush=True)


@contextlib.contextmanager
def _ending_on_signals(stop: threading.Event, wake: threading.Event) -> Iterator[None]:
    """SIGTERM and SIGINT set ``stop``; elsewhere than in the main thread signals are somebody else's."""

    def end(_number: int, _frame: FrameType | None) -> None:
        stop.set()
        wake.set()

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, end) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
