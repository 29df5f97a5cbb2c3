"""The viewer process: lock, page, feed and commands; a loop keeps the page up to date until it is told to end."""

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
from process.viewer.panels.measure_panel import MeasurePanel
from process.viewer.panels.rig_panel import RigPanel
from process.viewer.panels.scans_panel import ScansPanel
from process.viewer.panels.status_panel import StatusPanel
from process.viewer.panels.view_panel import ViewPanel
from process.viewer.rig_client.commands import CommandThread
from process.viewer.rig_client.feed import FeedThread, Snapshot
from process.viewer.scene.scene import RigShown, ViewerScene
from process.viewer.server.access_control import AccessControl
from process.viewer.server.guarded_server import GuardedServer, listen, start_server, stop_server
from process.viewer.stream.colouring import ViewSettings

TURN_S = 0.04
"""Least time between two turns: the texts on the page are never older than this and a little."""
DRAW_NS = 500_000_000
"""Least time between two changes of the scene: drawing is what keeps a browser from showing newer texts."""
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
        AccessControlError: the page would be open to strangers.
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
        self._access = AccessControl(settings.host)
        listener = listen(settings.host, settings.port if port is None else port)
        self._server = start_server(self._access, listener, settings.max_bytes_per_s)
        self.url = f"http://{self._access.authority(self._server.get_port())}/?token={self._access.token}"
        """The address with the token, as it is printed."""
        self._status = StatusPanel(self._server, view_only=self._access.view_only)
        self._view_settings = ViewSettings(max_points=settings.max_points)
        self._scene = ViewerScene(self._server, self._view_settings, self._clock, config.rig.reconstruct.calibration)
        self._controls = None if self._access.view_only else _Controls(self._server, self._scene, config, run_dir, wake)
        self._feed = FeedThread(run_dir, wake, self._clock)
        self._watching = False
        self._drawn_ns = 0

    def __enter__(self) -> Viewer:
        self._turn()
        self._feed.start()
        if self._controls is not None:
            self._controls.commands.start()
        self._access.arm()
        return self

    def __exit__(self, *_: object) -> None:
        self._feed.close()
        if self._controls is not None:
            self._controls.commands.close()
        stop_server(self._server)
        if self._controls is not None:
            self._controls.scans.close()

    def run(self, stop: threading.Event) -> None:
        """Keep the page up to date until ``stop`` is set (and ``wake`` with it)."""
        notifier = Notifier()
        notifier.ready("the page is served")
        while not stop.is_set():
            self._wake.wait(TURN_S if self._scene.streams.pending else BEAT_S)
            self._wake.clear()
            self._turn()
            notifier.alive()
            stop.wait(TURN_S)

    def _turn(self) -> None:
        now_ns, snapshot, controls = self._clock.now_ns(), self._feed.snapshot(), self._controls
        if now_ns - self._drawn_ns >= DRAW_NS:
            self._drawn_ns = now_ns
            self._draw(snapshot, now_ns)
        self._scene.apply(self._view_settings if controls is None else controls.view.settings, now_ns)
        facts = self._scene.facts
        if controls is not None:
            shown = controls.scans.shown
            controls.measure.forget(shown.title)
            controls.measure.turn(shown.pickable(self._scene.nodes.tiles), self._scene.eye_mm)
            facts = replace(facts, opened=shown.opened.entry.label if shown.opened is not None else "")
            controls.rig.show(snapshot, now_ns)
        self._scene.streams.turn(now_ns)
        self._status.show(snapshot, now_ns, facts)

    def _draw(self, snapshot: Snapshot, now_ns: int) -> None:
        """What costs a browser something: points, picture, lines."""
        watched = bool(self._server.get_clients())
        if watched != self._watching:
            self._watching = watched
            self._feed.watch(watched)  # camera pictures only while a browser shows the page
        changes, pixels = self._feed.take_tiles(), self._feed.take_pixels()
        controls = self._controls
        if controls is None:
            self._scene.show(snapshot, changes, pixels, RigShown())
            return
        controls.scans.turn(snapshot, now_ns, watched=watched)
        shown = controls.scans.shown
        opened = shown.folder if shown.opened is not None else None
        self._scene.show(snapshot, shown.changes(changes), pixels, controls.camera.shown, opened)
        controls.camera.show(snapshot, now_ns, pixels)
        controls.view.show(self._scene.nodes)


class _Controls:
    """What only a page that is bound to loopback has: the commands, and the panels in tabs."""

    def __init__(
        self, server: GuardedServer, scene: ViewerScene, config: LoadedConfig, run_dir: Path, wake: threading.Event
    ) -> None:
        self.commands = CommandThread(run_dir, config.rig.limits.command_s, wake.set)
        self.rig = RigPanel(server, self.commands)
        tabs = server.gui.add_tab_group()
        with tabs.add_tab("Rig"):
            self.rig.fill()
        with tabs.add_tab("View"):
            self.view = ViewPanel(server, scene.camera_views, config.rig.viewer.max_points)
        with tabs.add_tab("Camera"):
            self.camera = CameraPanel(server)
        with tabs.add_tab("Measure"):
            self.measure = MeasurePanel(server, scene.nodes, wake.set)
        with tabs.add_tab("Scans"):
            self.scans = ScansPanel(server, config.data_dir, scene.streams, wake.set)


def announce(url: str, run_dir: Path) -> None:
    """Print the address on a line of its own, and leave it in ``viewer.url``, for those who may use the sockets."""
    target = run_dir / URL_FILE
    mode = 0o640 if run_dir.stat().st_mode & 0o010 else 0o600
    replace_file(target, f"{url}\n".encode("ascii"), mode=mode)
    # more people can read the journal than the file
    print(f"the address of the page is in {target}" if is_journal(sys.stdout) else url, flush=True)


@contextlib.contextmanager
def _ending_on_signals(stop: threading.Event, wake: threading.Event) -> Iterator[None]:
    """SIGTERM and SIGINT set ``stop``; outside of the main thread signals are left alone."""

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
