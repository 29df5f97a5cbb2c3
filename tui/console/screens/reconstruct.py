"""The reconstruct screen: the four maps of a sweep or an older scan, their contrast threshold, and making the files."""

from __future__ import annotations

import asyncio
from pathlib import Path

from textual.app import ComposeResult
from textual.binding import Binding
from textual.events import Resize
from textual.geometry import Size
from textual.widgets import Static

from acquire.contract.errors import SweepscopeError
from tui.console.jobs import Job
from tui.console.link.rig_view import MapsView, RigView
from tui.console.pictures.maps import MapSet
from tui.console.pictures.maps_file import maps_of_sweep, read_maps
from tui.console.pictures.maps_in_view import MAX_CONTRAST, MapsInView
from tui.console.screens.base import RigScreenBase
from tui.console.screens.dialogs import FormDialog, FormField
from tui.console.shell import Shell
from tui.console.state.scan_forms import parse_folder
from tui.console.widgets.contrast_pane import ContrastPane, ContrastView
from tui.console.widgets.job_lines import JobLines
from tui.console.widgets.map_grid import MapGrid
from tui.console.widgets.map_view import MapView
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
        Binding("x", "cancel", "cancel", id="reconstruct.cancel", tooltip="cancel the reconstruction"),
        Binding("L", "live", "live", id="reconstruct.live", tooltip="back to the sweep"),
        *[
            Binding(f"{shift}{key}", f"cursor({down},{right})", "cursor", show=False)
            for shift, by in (("", 1), ("shift+", 8))
            for key, down, right in (("up", -by, 0), ("down", by, 0), ("left", 0, -by), ("right", 0, by))
        ],
    ]
    DEFAULT_CSS = """
    ReconstructScreen #nothing { height: 1fr; content-align: center middle; text-align: center; color: $text-muted;
                                 padding: 0 4; }
    """

    def __init__(self, shell: Shell) -> None:
        super().__init__(shell)
        self._grid = MapGrid(plain=shell.options.ascii_only)
        self._nothing = Static("", id="nothing", markup=False)
        self._pane = ContrastPane(ContrastView())
        self._job_lines = JobLines(())
        self._shown = MapsInView()
        self._method = 0
        self._folder: Path | None = None
        """The older scan that is shown; None: the sweep."""
        self._live: MapsView | None = None
        self._problem = ""
        self._last = ""

    def body(self) -> ComposeResult:
        """Maps above, the threshold below."""
        yield self._grid
        yield self._nothing
        yield self._pane
        yield self._job_lines

    # ---- which maps are shown ----

    def open_scan(self, folder: Path) -> None:
        """Show the maps of an older scan."""
        self._folder, self._problem, self._last = folder, "", ""
        self._shown.forget(threshold=True)
        self.app.run_worker(self._read(folder), exit_on_error=False)

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
        """The sweep's newest maps, unless an older scan is shown."""
        is_of_sweep = _is_of_sweep(view)
        if self._folder is None and not is_of_sweep:
            self._shown.forget()
        if self._folder is None and is_of_sweep and view.maps is not None and view.maps is not self._live:
            self._live = view.maps
            self._take(maps_of_sweep(view.maps, view.progress))
        else:
            self._draw()
        self._job_lines.show(self.jobs.work)

    def _take(self, maps: MapSet) -> None:
        self._problem = ""
        self._shown.take(maps)
        self._draw()

    # ---- drawing ----

    def on_resize(self, event: Resize) -> None:
        """Draw again once the new sizes are known."""
        super().on_resize(event)
        self.call_after_refresh(self._draw)

    def _draw(self) -> None:
        if not self.is_mounted:
            return
        shown = self._shown
        self._grid.display, self._nothing.display = shown.maps is not None, shown.maps is None
        if shown.maps is None or shown.window is None:
            self._nothing.update(self._problem or self._waiting_words())
            self._pane.show(ContrastView(self._source(), warning=self._problem, contrast=shown.contrast or 0))
            return
        place = self.query_one("#body").size
        room = Size(max(0, place.width - 2), max(0, place.height - self._pane.outer_size.height))
        self._grid.show(shown.layers(), shown.window, room)
        self._pane.show(
            ContrastView(
                source=self._source(),
                contrast=shown.contrast or 0,
                counts=shown.counts(),
                histogram=shown.histogram,
                values=shown.words(),
                settings=self._settings_words(shown.maps),
            )
        )

    def _waiting_words(self) -> str:
        if self._folder is not None:
            return "reading ..."
        if not self.view.connected:
            return "not connected - retrying; 4 opens an older scan"
        if is_running(self.view.status):
            return "waiting for the worker's first maps"
        return "no sweep yet; 4 opens an older scan"

    def _source(self) -> str:
        if self._folder is not None:
            return f"{self._folder.name} (maps.h5)"
        status, maps = self.view.status, self._shown.maps
        name = Path(status.scan_path).name if status and status.scan_path else "the sweep"
        return f"live: {name}" + (f", through frame {maps.folded_through} of {maps.frames}" if maps else "")

    def _settings_words(self, maps: MapSet) -> str:
        below = self._shown.contrast is not None and self._shown.contrast < maps.contrast
        hint = f"; crossings under {maps.contrast} are not known until g makes it" if below else ""
        sampled = f", 1 pixel of {maps.step} each way shown" if maps.step > 1 else ""
        last = f"   {self._last}" if self._last else ""
        return f"method {METHODS[self._method]}, median {maps.median_px} px{sampled}{hint}{last}"

    # ---- actions ----

    @property
    def _scan(self) -> Path | None:
        """The scan whose files can be made."""
        if self._folder is not None:
            return self._folder
        status = self.view.status
        return Path(status.scan_path) if status is not None and status.scan_path else None

    def why_not(self, action: str) -> str:
        """There must be maps, or a scan that is not running."""
        job = self.jobs.running_on(str(self._scan)) if self._scan else None
        if action in ("contrast", "threshold", "zoom", "cursor"):
            return "" if self._shown.maps is not None else "there are no maps"
        if action == "cancel":
            return "" if job else "nothing is running"
        if action == "live":
            return "" if self._folder is not None else "the sweep is shown already"
        return self._why_not_make(job) if action in ("make", "export") else ""

    def _why_not_make(self, job: Job | None) -> str:
        if self._scan is None:
            return "there is no scan yet"
        if self._folder is None and is_running(self.view.status):
            return "the sweep is running: its files are made at its end"
        return "it is being made: x cancels" if job else ""

    def action_contrast(self, counts: int) -> None:
        """Change the threshold."""
        if self._shown.contrast is not None:
            self._set_contrast(self._shown.contrast + counts)

    def _set_contrast(self, contrast: int) -> None:
        self._shown.set_contrast(contrast)
        self._draw()

    def action_threshold(self) -> None:
        """Type the threshold."""
        field = FormField("contrast", "contrast", str(self._shown.contrast), help="0 to 255 counts of 8 bit")
        self.ask(FormDialog("contrast threshold", [field], _contrast), self._set_contrast)

    def action_zoom(self, steps: int) -> None:
        """In (1) or out (-1)."""
        self._shown.zoom(steps)
        self._draw()

    def action_cursor(self, down: int, right: int) -> None:
        """Move by about one cell of what is drawn."""
        self._shown.move(down, right, self._grid.cells_across)
        self._draw()

    def on_map_view_pointed(self, message: MapView.Pointed) -> None:
        """Move the cursor to the clicked cell."""
        self._shown.point(message.row, message.column, message.rows, message.columns)
        self._draw()

    def action_which(self) -> None:
        """One map alone, the next, all four."""
        self._grid.show_next()
        self._draw()

    def action_method(self) -> None:
        """The next method."""
        self._method = (self._method + 1) % len(METHODS)
        self._draw()

    def action_live(self) -> None:
        """Back to the sweep."""
        self._folder, self._live = None, None
        self._shown.forget(threshold=True)
        self.show_all(self.view)

    def action_make(self) -> None:
        """Make maps, cloud and report of this scan with these settings."""
        self._make([])

    def action_export(self) -> None:
        """Make them in another folder; the files beside the scan stay."""
        field = FormField("out", "into the folder", "", help="maps.h5, cloud.ply and report.json; made if missing")
        form = FormDialog(
            "export with these settings", [field], lambda texts: parse_folder(texts["out"]), done="makes them"
        )
        self.ask(form, lambda out: self._make(["--out", out]))

    def _make(self, more: list[str]) -> None:
        scan = self._scan
        assert scan is not None
        arguments = ["reconstruct", str(scan), "--json", "--progress"]
        if self._shown.contrast is not None:
            arguments += ["--contrast", str(self._shown.contrast)]
        if self._method:
            arguments += ["--method", METHODS[self._method]]

        def ended(job: Job) -> None:
            if job.result is not None and not job.cancelled:
                self._last = reconstruct_words(job.result)
                self.say(f"{scan.name}: {self._last}")
                if not more:
                    self.open_scan(scan)

        self.jobs.start(f"reconstruct {scan.name}", [*arguments, *more], str(scan), ended)

    def action_cancel(self) -> None:
        """Cancel the reconstruction."""
        self.jobs.cancel(self.jobs.running_on(str(self._scan)))


def _is_of_sweep(view: RigView) -> bool:
    """True if the newest maps belong to the scan that the daemon reports."""
    if view.maps is None:
        return False
    return view.status is None or view.status.scan_uid in ("", view.maps.header.scan_uid)


def _contrast(texts: dict[str, str]) -> int:
    if not texts["contrast"].isdigit() or int(texts["contrast"]) > MAX_CONTRAST:
        raise ValueError(f"give a whole number from 0 to {MAX_CONTRAST}")
    return int(texts["contrast"])
