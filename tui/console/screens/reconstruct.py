"""The reconstruct screen: the four maps of a sweep or an older scan, a contrast that shows at once, and making it."""

from __future__ import annotations

import asyncio
from pathlib import Path

from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Grid
from textual.widgets import Static

from acquire.contract.errors import SweepscopeError
from tui.console.link.rig_view import MapsView, RigView
from tui.console.pictures.maps import MapSet, Quantity
from tui.console.pictures.maps_file import maps_of_sweep, read_maps
from tui.console.pictures.maps_in_view import MOST_CONTRAST, MapsInView
from tui.console.screens.base import RigScreenBase
from tui.console.screens.dialogs import Field, Form
from tui.console.widgets.contrast_pane import ContrastPane, ContrastView
from tui.console.widgets.job_lines import JobLines
from tui.console.widgets.map_view import MapView
from tui.processes.child_jobs import Job
from tui.scans.scan_text import reconstruct_words
from tui.text.status_text import is_running

METHODS = ("as recorded", "auto", "fit", "probit", "linear")


class ReconstructScreen(RigScreenBase):
    """Maps and cloud."""

    NAME = "reconstruct"
    SUMMARY = (
        "The four maps: lowest and highest brightness of each pixel, where their difference is over the contrast, "
        "and when the light crossed it. The threshold shows at once; g makes the scan's files with it."
    )
    BINDINGS = [
        Binding("left_square_bracket", "contrast(-1)", "contrast -", id="reconstruct.less", tooltip="by 1; { by 10"),
        Binding("right_square_bracket", "contrast(1)", "contrast +", id="reconstruct.more", tooltip="by 1; } by 10"),
        Binding("left_curly_bracket", "contrast(-10)", "contrast -10", show=False),
        Binding("right_curly_bracket", "contrast(10)", "contrast +10", show=False),
        Binding("t", "threshold", "threshold", id="reconstruct.threshold", tooltip="type the contrast"),
        Binding("equals_sign", "zoom(1)", "zoom in", show=False),
        Binding("plus", "zoom(1)", "zoom in", id="reconstruct.nearer", tooltip="about the cursor"),
        Binding("minus", "zoom(-1)", "zoom out", id="reconstruct.further"),
        Binding("w", "which", "one map", id="reconstruct.which", tooltip="one map large, the next, all four again"),
        Binding("k", "method", "method", id="reconstruct.method", tooltip="how a crossing is estimated"),
        Binding("g", "make", "make it", id="reconstruct.make", tooltip="maps, cloud and report with these settings"),
        Binding("E", "export", "export", id="reconstruct.export", tooltip="the same into another folder"),
        Binding("x", "cancel", "cancel", id="reconstruct.cancel", tooltip="end the reconstruction that runs"),
        Binding("L", "live", "live", id="reconstruct.live", tooltip="back to the sweep"),
        *[
            Binding(f"{shift}{key}", f"cursor({down},{right})", "cursor", show=False)
            for shift, by in (("", 1), ("shift+", 8))
            for key, down, right in (("up", -by, 0), ("down", by, 0), ("left", 0, -by), ("right", 0, by))
        ],
    ]
    DEFAULT_CSS = """
    ReconstructScreen #maps { grid-size: 4; grid-gutter: 0 1; height: 1fr; padding: 0 1; }
    ReconstructScreen #maps.square { grid-size: 2; }
    ReconstructScreen #maps.one { grid-size: 1; }
    ReconstructScreen #nothing { height: 1fr; content-align: center middle; text-align: center; color: $text-muted;
                                 padding: 0 4; }
    """

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(ascii_only=ascii_only)
        self._views = {quantity: MapView(id=quantity.name.lower(), plain=ascii_only) for quantity in Quantity}
        self._nothing = Static("", id="nothing", markup=False)
        self._pane = ContrastPane(ascii_only=ascii_only)
        self._jobs = JobLines(ascii_only=ascii_only)
        self._seen = MapsInView()
        self._alone: Quantity | None = None
        self._method = 0
        self._folder: Path | None = None
        """The older scan that is shown; None: the sweep."""
        self._live: MapsView | None = None
        self._problem = ""
        self._last = ""

    def body(self) -> ComposeResult:
        """Maps above, the threshold below."""
        yield Grid(*self._views.values(), id="maps")
        yield self._nothing
        yield self._pane
        yield self._jobs

    # ---- where the maps come from ----

    def open_scan(self, folder: Path) -> None:
        """Show the maps of an older scan."""
        self._folder, self._problem, self._last = folder, "", ""
        self._seen.forget(threshold=True)
        self.shell.run_worker(self._read(folder), exit_on_error=False)

    async def _read(self, folder: Path) -> None:
        try:
            maps = await asyncio.to_thread(read_maps, folder)
        except SweepscopeError as error:
            if folder == self._folder:
                self._problem = str(error)
                self._draw()
            return
        if folder == self._folder:
            self._take(maps)
            self.shell.refresh_view()

    def show(self, view: RigView) -> None:
        """The sweep's newest maps, unless an older scan is looked at."""
        if self._folder is None and _is_of_another_scan(view):
            self._seen.forget()
        if self._folder is None and view.maps is not self._live and not _is_of_another_scan(view):
            assert view.maps is not None
            self._live = view.maps
            self._take(maps_of_sweep(view.maps, view.progress))
        else:
            self._draw()
        self._jobs.show(self.shell.jobs.work)

    def _take(self, maps: MapSet) -> None:
        self._problem = ""
        self._seen.take(maps)
        self._draw()

    # ---- what is seen ----

    def on_resize(self, event: object) -> None:
        """Four in a row or in a square, whichever shows more."""
        super().on_resize(event)  # type: ignore[arg-type]
        self.call_after_refresh(self._draw)

    def _draw(self) -> None:
        if not self.is_mounted:
            return
        seen = self._seen
        self.query_one("#maps").display, self._nothing.display = seen.maps is not None, seen.maps is None
        most_across = self._arrange()
        if seen.maps is None or seen.window is None:
            self._nothing.update(self._problem or self._waiting_words())
            self._pane.show(ContrastView(source=self._source(), warning=self._problem, contrast=seen.contrast or 0))
            return
        for layer in seen.layers():
            self._views[layer.quantity].show(layer, seen.window, most_across)
        self._pane.show(
            ContrastView(
                source=self._source(),
                contrast=seen.contrast or 0,
                counts=seen.counts(),
                histogram=seen.histogram,
                values=seen.words(),
                settings=self._settings_words(seen.maps),
            )
        )

    @property
    def _first_view(self) -> MapView:
        return self._views[self._alone or Quantity.MINIMUM]

    def _arrange(self) -> int:
        """Choose how the maps stand; returns how many cells wide each may be."""
        grid = self.query_one("#maps", Grid)
        rows, columns = self._seen.maps.shape if self._seen.maps else (3, 4)
        place = self.query_one("#body").size
        width, height = max(8, place.width - 2), max(4, place.height - self._pane.outer_size.height)
        row = min(width / 4 / columns, 2 * (height - 2) / rows)
        square = min(width / 2 / columns, 2 * (height / 2 - 2) / rows)
        grid.set_class(self._alone is not None, "one")
        grid.set_class(self._alone is None and square > row, "square")
        for quantity, view in self._views.items():
            view.display = self._alone in (None, quantity)
        columns = 1 if self._alone is not None else 2 if square > row else 4
        return (width - columns + 1) // columns - 1

    def _waiting_words(self) -> str:
        status = self.view.status
        if self._folder is not None:
            return "reading ..."
        if not self.view.connected:
            return "not connected - retrying; 4 opens an older scan"
        if is_running(status):
            return "waiting for the worker's first maps"
        return "no sweep yet; 4 opens an older scan"

    def _source(self) -> str:
        if self._folder is not None:
            return f"{self._folder.name} (maps.h5)"
        status, maps = self.view.status, self._seen.maps
        name = Path(status.scan_path).name if status and status.scan_path else "the sweep"
        return f"live: {name}" + (f", through frame {maps.folded_through} of {maps.frames}" if maps else "")

    def _settings_words(self, maps: MapSet) -> str:
        below = self._seen.contrast is not None and self._seen.contrast < maps.contrast
        hint = f"; crossings under {maps.contrast} are not known until g makes it" if below else ""
        sampled = f", 1 pixel of {maps.step} each way shown" if maps.step > 1 else ""
        last = f"   {self._last}" if self._last else ""
        return f"method {METHODS[self._method]}, median {maps.median_px} px{sampled}{hint}{last}"

    # ---- what can be done ----

    @property
    def _scan(self) -> Path | None:
        """The scan that can be made again."""
        if self._folder is not None:
            return self._folder
        status = self.view.status
        return Path(status.scan_path) if status is not None and status.scan_path else None

    def why_not(self, action: str) -> str:
        """Maps must be there; a scan that is running is not made again."""
        job = self.shell.jobs.board.running_on(str(self._scan)) if self._scan else None
        if action in ("contrast", "threshold", "zoom", "cursor"):
            return "" if self._seen.maps is not None else "there are no maps to see"
        if action == "cancel":
            return "" if job else "nothing runs"
        if action == "live":
            return "" if self._folder is not None else "this is the sweep already"
        return self._why_not_make(job) if action in ("make", "export") else ""

    def _why_not_make(self, job: Job | None) -> str:
        if self._scan is None:
            return "there is no scan yet"
        if self._folder is None and is_running(self.view.status):
            return "the sweep runs: its files are made at its end"
        return "it is being made: x cancels" if job else ""

    def action_contrast(self, counts: int) -> None:
        """Another threshold."""
        if self._seen.contrast is not None:
            self._set_contrast(self._seen.contrast + counts)

    def _set_contrast(self, contrast: int) -> None:
        self._seen.set_contrast(contrast)
        self._draw()

    def action_threshold(self) -> None:
        """Type it."""
        field = Field("contrast", "contrast", str(self._seen.contrast), help="0 to 255 counts of 8 bit")

        def take(contrast: int | None) -> None:
            if contrast is not None:
                self._set_contrast(contrast)

        self.shell.push_screen(Form("contrast threshold", [field], _contrast), take)

    def action_zoom(self, steps: int) -> None:
        """Nearer or further."""
        self._seen.zoom(steps)
        self._draw()

    def action_cursor(self, down: int, right: int) -> None:
        """Move by about one cell of what is drawn."""
        self._seen.move(down, right, self._first_view.picture_cells[1])
        self._draw()

    def on_map_view_pointed(self, message: MapView.Pointed) -> None:
        """The cursor goes where it was clicked."""
        self._seen.point(message.row, message.column, message.rows, message.columns)
        self._draw()

    def action_which(self) -> None:
        """One map, the next, all."""
        order: list[Quantity | None] = [None, *Quantity]
        self._alone = order[(order.index(self._alone) + 1) % len(order)]
        self._draw()

    def action_method(self) -> None:
        """The next method."""
        self._method = (self._method + 1) % len(METHODS)
        self._draw()

    def action_live(self) -> None:
        """Back to the sweep."""
        self._folder, self._live = None, None
        self._seen.forget(threshold=True)
        self.show_all(self.view)

    def action_make(self) -> None:
        """Make maps, cloud and report of this scan with these settings."""
        self._make(None)

    def action_export(self) -> None:
        """The same elsewhere; what is beside the scan stays."""
        field = Field("out", "into the folder", "", help="maps.h5, cloud.ply and report.json go there")

        def export(out: str | None) -> None:
            if out:
                self._make(out)

        self.shell.push_screen(Form("export with these settings", [field], _folder, done="makes them"), export)

    def _make(self, out: str | None) -> None:
        scan = self._scan
        assert scan is not None
        arguments = ["reconstruct", str(scan), "--json", "--progress"]
        if self._seen.contrast is not None:
            arguments += ["--contrast", str(self._seen.contrast)]
        if self._method:
            arguments += ["--method", METHODS[self._method]]
        if out is not None:
            arguments += ["--out", out]

        def ended(job: Job) -> None:
            if job.result is not None and not job.cancelled:
                self._last = reconstruct_words(job.result)
                self.say(f"{scan.name}: {self._last}")
                if out is None:
                    self.open_scan(scan)

        self.shell.jobs.start(f"reconstruct {scan.name}", arguments, str(scan), ended)

    def action_cancel(self) -> None:
        """End the reconstruction."""
        job = self.shell.jobs.board.running_on(str(self._scan))
        if job is not None:
            self.shell.jobs.cancel(job)


def _is_of_another_scan(view: RigView) -> bool:
    """The maps that were heard last are not those of the scan that the daemon tells of; or none were heard."""
    if view.maps is None:
        return True
    return view.status is not None and view.status.scan_uid not in ("", view.maps.header.scan_uid)


def _contrast(texts: dict[str, str]) -> int:
    if not texts["contrast"].isdigit() or int(texts["contrast"]) > MOST_CONTRAST:
        raise ValueError("give a whole number from 0 to 255")
    return int(texts["contrast"])


def _folder(texts: dict[str, str]) -> str:
    path = Path(texts["out"]).expanduser()
    if not texts["out"] or not path.is_absolute():
        raise ValueError("give the whole path of a folder; it is made if it is not there")
    return str(path)
