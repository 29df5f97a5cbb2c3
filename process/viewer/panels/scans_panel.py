"""Widgets for the choice of the shown scan, and for the files that people take away.

One thread reads and makes files; what it found goes through a queue to the main loop, which alone changes the cloud.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import viser

from acquire.contract.errors import SweepscopeError
from acquire.contract.states import Outcome
from acquire.contract.units import NS_PER_S
from process.viewer.exports.files import file_of, report_of, screenshot_of
from process.viewer.exports.results_list import ListedScan, OpenedScan, facts_of, list_scans, open_scan, read_tiles
from process.viewer.exports.shown_cloud import ShownCloud
from process.viewer.rig_client.feed import Snapshot
from process.viewer.status_html import small_html
from process.viewer.stream.browser_stream import BrowserStreams

from .shown_scan import ShownScan
from .widgets import JobQueue, write

LIVE = "the rig's own"
LIST_NS = 5 * NS_PER_S
RENDER_TIMEOUT_S = 8.0


class ScansPanel:
    """Open an older scan, go back to the rig's, export what is shown; the same for all browsers."""

    def __init__(
        self, server: viser.ViserServer, data_dir: Path, streams: BrowserStreams, wake: Callable[[], None]
    ) -> None:
        self._data_dir = data_dir
        self._streams = streams
        self._jobs = JobQueue(wake)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="viewer-files")
        self._entries: dict[str, ListedScan] = {}
        self._wanted = LIVE
        self._list_ns = 0
        self._followed = ""
        self.shown = ShownScan()
        gui = server.gui
        self._which = gui.add_dropdown("Scan", (LIVE,), hint="Scans that have a cloud, newest first")
        self._follow = gui.add_checkbox("Follow new scans", True, hint="Go back to the rig's when a sweep starts")
        self._text = gui.add_html("")
        with gui.add_folder("Take away"):
            files = gui.add_button_group(
                "Files",
                ("PLY", "3D page", "Report", "Figure"),
                hint="The cloud; it and its numbers in one offline page; the scan's report; a PNG",
            )
            picture = gui.add_button("Screenshot", icon=viser.Icon.CAMERA)
        self._which.on_update(self._choose)
        files.on_click(self._export)
        picture.on_click(self._screenshot)

    def close(self) -> None:
        """End the thread; files that were not begun are given up."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    # ---- from the browsers: the server's loop ----

    async def _choose(self, _event: Any) -> None:
        chosen = str(self._which.value)
        self._jobs.put(lambda: self._open(chosen))

    async def _export(self, event: Any) -> None:
        kind, client = str(event.target.value), event.client
        if client is not None:
            self._jobs.put(lambda: self._begin_export(kind, client))

    async def _screenshot(self, event: Any) -> None:
        client = event.client
        if client is not None:
            self._submit(self._render, client)

    def _submit(self, job: Callable[..., None], *args: Any) -> None:
        """Let the thread do it; what goes wrong there is shown on the page."""

        def ended(future: Future[None]) -> None:
            if not future.cancelled() and (error := future.exception()) is not None:
                kind = "" if isinstance(error, SweepscopeError) else f"{type(error).__name__}: "
                words = f"that did not work: {kind}{error}"
                self._jobs.put(lambda: self._say(words))

        with contextlib.suppress(RuntimeError):  # the page is being closed
            self._thread.submit(job, *args).add_done_callback(ended)

    # ---- in the thread ----

    def _list(self) -> None:
        entries = list_scans(self._data_dir)
        self._jobs.put(lambda: self._offer(entries))

    def _read(self, label: str, entry: ListedScan) -> None:
        try:
            opened = open_scan(entry)
        except (SweepscopeError, MemoryError) as error:
            words = str(error)
            self._jobs.put(lambda: self._say(words))
            return
        self._jobs.put(lambda: self._show(label, opened))

    def _read_finished(self, cloud_path: str) -> None:
        with contextlib.suppress(SweepscopeError):  # then the live points will do
            tiles = read_tiles(Path(cloud_path).parent)
            self._jobs.put(lambda: self.shown.take_finished(cloud_path, tiles))

    def _make(self, client: viser.ClientHandle, make: Callable[[], tuple[str, bytes]]) -> None:
        name, content = make()
        self._jobs.put(lambda: self._streams.offer_file(client.client_id, name, content))

    def _render(self, client: viser.ClientHandle) -> None:
        camera = client.camera
        height, width = max(1, camera.image_height), max(1, camera.image_width)
        # the browser may be gone, or its tab in the background
        with contextlib.suppress(RuntimeError, TimeoutError):
            pixels = client.get_render(height, width, timeout=RENDER_TIMEOUT_S)
            self._make(client, lambda: ("sweepscope.png", screenshot_of(pixels)))

    # ---- in the main loop ----

    def turn(self, snapshot: Snapshot, now_ns: int, *, watched: bool) -> None:
        """Do what was asked for; look for new scans now and then while a browser shows the page."""
        self._jobs.run()
        if watched and now_ns - self._list_ns >= LIST_NS:
            self._list_ns = now_ns
            self._submit(self._list)
        self.shown.take(snapshot)
        if watched and (path := self.shown.newly_finished()):
            self._submit(self._read_finished, path)
        status = snapshot.status
        if status is not None and status.scan_uid != self._followed and status.outcome == Outcome.RUNNING:
            self._followed = status.scan_uid
            if self._follow.value and self.shown.opened is not None:
                self._open(LIVE)

    def _open(self, label: str) -> None:
        self._wanted = label
        entry = self._entries.get(label)
        if entry is not None:
            self._say(f"opening {entry.name} ...")
            self._submit(self._read, label, entry)
            return
        self.shown.show(None)
        write(self._which, value=LIVE)
        self._say("")

    def _show(self, label: str, opened: OpenedScan) -> None:
        if label != self._wanted:
            return  # another one was chosen meanwhile
        self.shown.show(opened)
        self._say("")

    def _offer(self, entries: list[ListedScan]) -> None:
        self._entries = {entry.label: entry for entry in entries}
        if self._wanted != LIVE and self._wanted not in self._entries and self.shown.opened is not None:
            shown = [label for label, entry in self._entries.items() if entry.folder == self.shown.folder]
            self._wanted = shown[0] if shown else self._wanted  # its report has been written anew
        options = (LIVE, *self._entries)
        if self._wanted not in options:
            options = (*options, self._wanted)
        if self._which.options != options:
            self._which.options = options
            write(self._which, value=self._wanted)

    def _begin_export(self, kind: str, client: viser.ClientHandle) -> None:
        nodes, folder, title = self._streams.nodes, self.shown.folder, self.shown.title
        if kind == "Report":
            self._submit(self._make, client, lambda: (f"{title}-report.html", report_of(folder)))
            return
        cloud = ShownCloud(
            title=title,
            tiles=dict(nodes.tiles),
            settings=nodes.settings,
            within=nodes.range,
            plane=nodes.plane,
            legend=nodes.legend(),
            facts=facts_of(folder),
        )
        self._submit(self._make, client, lambda: file_of(kind, cloud))

    def _say(self, words: str) -> None:
        write(self._text, content=small_html(words))
