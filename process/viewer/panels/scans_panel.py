"""Owns the choice of the scan that is shown, and what can be taken away: files are read and made beside the main loop.

One thread reads and makes files; what it finds is handed to the main loop, which owns the cloud.
"""

from __future__ import annotations

import contextlib
import queue
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import viser

from acquire.contract.errors import SweepscopeError
from acquire.contract.scan_data.report_file import find_report
from acquire.contract.states import Outcome
from acquire.contract.units import NS_PER_S
from process.viewer.exports.exports import View
from process.viewer.exports.files import file_of, report_of, screenshot_of
from process.viewer.exports.results_list import Entry, Opened, list_scans, open_scan
from process.viewer.markup import small_html
from process.viewer.rig_client.feed import Snapshot, TileChanges
from process.viewer.rig_client.tile import Tile
from process.viewer.stream.streams import Delivery

from .widgets import write

LIVE = "the rig's own"
LIST_NS = 5 * NS_PER_S
RENDER_TIMEOUT_S = 8.0
WAITING = 32


class ScansPanel:
    """Open an older scan, go back to the rig's, export what is shown; the same for all browsers."""

    def __init__(self, server: viser.ViserServer, data_dir: Path, delivery: Delivery, wake: Callable[[], None]) -> None:
        self._data_dir = data_dir
        self._delivery = delivery
        self._wake = wake
        self._done: queue.Queue[Callable[[], None]] = queue.Queue(WAITING)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="viewer-files")
        self._live: dict[int, Tile] = {}
        self._switched = False
        self._entries: dict[str, Entry] = {}
        self._wanted = LIVE
        self._list_ns = 0
        self._followed = ""
        self._snapshot = Snapshot()
        self._finished_path = ""
        self._finished: dict[int, Tile] = {}
        self.opened: Opened | None = None
        """The older scan that is shown; None: the rig's."""
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
        self._put(lambda: self._open(chosen))

    async def _export(self, event: Any) -> None:
        kind, client = str(event.target.value), event.client
        if client is not None:
            self._put(lambda: self._begin_export(kind, client))

    async def _screenshot(self, event: Any) -> None:
        client = event.client
        if client is not None:
            self._submit(self._render, client)

    def _put(self, job: Callable[[], None]) -> None:
        with contextlib.suppress(queue.Full):
            self._done.put_nowait(job)
        self._wake()

    def _submit(self, job: Callable[..., None], *args: Any) -> None:
        """Let the thread do it; what goes wrong there is said on the page."""

        def ended(future: Future[None]) -> None:
            if not future.cancelled() and (error := future.exception()) is not None:
                kind = "" if isinstance(error, SweepscopeError) else f"{type(error).__name__}: "
                words = f"that did not work: {kind}{error}"
                self._put(lambda: self._say(words))

        with contextlib.suppress(RuntimeError):  # the page is being closed
            self._thread.submit(job, *args).add_done_callback(ended)

    # ---- in the thread ----

    def _look(self) -> None:
        entries = list_scans(self._data_dir)
        self._put(lambda: self._offer(entries))

    def _read(self, label: str, entry: Entry) -> None:
        try:
            opened = open_scan(entry)
        except (SweepscopeError, MemoryError) as error:
            words = str(error)
            self._put(lambda: self._say(words))
            return
        self._put(lambda: self._show(label, opened))

    def _make(self, kind: str, view: View, client: viser.ClientHandle) -> None:
        name, content = file_of(kind, view)
        self._put(lambda: self._hand_over(client, name, content))

    def _make_report(self, folder: Path | None, title: str, client: viser.ClientHandle) -> None:
        content = report_of(folder)
        self._put(lambda: self._hand_over(client, f"{title}-report.html", content))

    def _render(self, client: viser.ClientHandle) -> None:
        camera = client.camera
        height, width = max(1, camera.image_height), max(1, camera.image_width)
        try:
            pixels = client.get_render(height, width, timeout=RENDER_TIMEOUT_S)
        except (RuntimeError, TimeoutError):
            return  # the browser is gone, or its tab is in the background
        content = screenshot_of(pixels)
        self._put(lambda: self._hand_over(client, "sweepscope.png", content))

    # ---- in the main loop ----

    def turn(self, snapshot: Snapshot, now_ns: int, *, watched: bool) -> None:
        """Answer what was asked; look for new scans now and then while somebody looks at the page."""
        self._snapshot = snapshot
        while not self._done.empty():
            self._done.get_nowait()()
        if watched and now_ns - self._list_ns >= LIST_NS:
            self._list_ns = now_ns
            self._submit(self._look)
        if watched:
            self._look_up_finished()
        status = snapshot.status
        if status is not None and status.scan_uid != self._followed and status.outcome == Outcome.RUNNING:
            self._followed = status.scan_uid
            if self._follow.value and self.opened is not None:
                self._open(LIVE)

    def news(self, news: TileChanges) -> TileChanges:
        """What the cloud has to take: the rig's news, or all of another scan when the choice has changed."""
        if news.reset:
            self._live.clear()
        self._live.update(news.tiles)
        if self._switched:
            self._switched = False
            return TileChanges(True, dict(self._live if self.opened is None else self.opened.tiles))
        return news if self.opened is None else TileChanges()

    @property
    def title(self) -> str:
        """What the shown scan is called."""
        if self.opened is not None:
            return self.opened.entry.name
        status = self._snapshot.status
        return Path(status.scan_path).name if status is not None and status.scan_path else "no scan"

    def _open(self, label: str) -> None:
        self._wanted = label
        entry = self._entries.get(label)
        if entry is not None:
            self._say(f"opening {entry.name} ...")
            self._submit(self._read, label, entry)
            return
        self.opened, self._switched = None, True
        write(self._which, value=LIVE)
        self._say("")

    def _show(self, label: str, opened: Opened) -> None:
        if label != self._wanted:
            return  # another one was chosen meanwhile
        self.opened, self._switched = opened, True
        self._say("")

    def _offer(self, entries: list[Entry]) -> None:
        self._entries = {entry.label: entry for entry in entries}
        shown = [label for label, entry in self._entries.items() if self._is_shown(entry)]
        if self._wanted != LIVE and self._wanted not in self._entries and shown:
            self._wanted = shown[0]  # its report has been written anew
        options = (LIVE, *self._entries)
        if self._wanted not in options:
            options = (*options, self._wanted)
        if self._which.options != options:
            self._which.options = options
            write(self._which, value=self._wanted)

    def _is_shown(self, entry: Entry) -> bool:
        return self.opened is not None and entry.folder == self.opened.entry.folder

    def _begin_export(self, kind: str, client: viser.ClientHandle) -> None:
        cloud = self._delivery.cloud
        view = View(
            title=self.title,
            tiles=dict(cloud.tiles),
            look=cloud.look,
            within=cloud.range,
            plane=cloud.plane,
            legend=cloud.legend(),
            facts=self._facts(),
        )
        if kind == "Report":
            self._submit(self._make_report, self._folder(), self.title, client)
        else:
            self._submit(self._make, kind, view, client)

    def _folder(self) -> Path | None:
        """Of the shown scan."""
        if self.opened is not None:
            return self.opened.entry.folder
        status = self._snapshot.status
        return Path(status.scan_path) if status is not None and status.scan_path else None

    def _facts(self) -> list[tuple[str, str]]:
        """Outcome, numbers and settings, as the report has them."""
        folder = self._folder()
        report = find_report(folder) if folder is not None else None
        if report is None:
            return [("Outcome", "still running")]
        facts = [("Outcome", report.outcome or "still running")]
        values, names = report.counts | report.settings, ("frames", "missing", "points", "method", "contrast", "edge")
        facts += [(name.capitalize(), str(values[name])) for name in names if name in values]
        return [*facts, ("Digest", report.digest[:16])] if report.digest else facts

    @property
    def pickable(self) -> Mapping[int, Tile]:
        """The shown points; those of a finished scan come from its file, which knows their quality."""
        if self.opened is None and self._finished and self._is_finished():
            return self._finished
        return self._delivery.cloud.tiles

    def _is_finished(self) -> bool:
        end = self._snapshot.end
        return end is not None and bool(end.cloud_path) and end.cloud_path == self._finished_path

    def _look_up_finished(self) -> None:
        """Once a scan's cloud is on disk, read it for what the live points do not carry."""
        end = self._snapshot.end
        if end is None or not end.cloud_path or end.cloud_path == self._finished_path:
            return
        self._finished_path, self._finished = end.cloud_path, {}
        folder = Path(end.cloud_path).parent
        self._submit(self._read_finished, end.cloud_path, Entry(folder, folder.name, "", None))

    def _read_finished(self, path: str, entry: Entry) -> None:
        with contextlib.suppress(SweepscopeError):  # then the live points will do
            tiles = open_scan(entry).tiles
            self._put(lambda: self._keep_finished(path, tiles))

    def _keep_finished(self, path: str, tiles: dict[int, Tile]) -> None:
        if path == self._finished_path:
            self._finished = tiles

    def _hand_over(self, client: viser.ClientHandle, name: str, content: bytes) -> None:
        self._delivery.post(client.client_id, name, content)

    def _say(self, words: str) -> None:
        write(self._text, content=small_html(words))
