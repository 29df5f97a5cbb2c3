"""The scans screen: the folder of scans and what can be done with one; a scan that is being taken is never touched."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding

from acquire.contract.errors import SweepscopeError
from acquire.contract.scan_data.notes import Notes, write_notes
from acquire.contract.units import format_bytes
from tui.console.jobs import Job
from tui.console.link.rig_view import RigView
from tui.console.screens.base import RigScreenBase
from tui.console.screens.dialogs import Confirm, FormDialog, FormField
from tui.console.screens.reconstruct import ReconstructScreen
from tui.console.screens.scan_list import ScanList
from tui.console.shell import Shell
from tui.console.state.scan_forms import parse_folder
from tui.console.widgets.job_lines import JobLines
from tui.console.widgets.rows import RowList, Rows
from tui.console.widgets.scan_rows import ScanDetail, columns_of, row_of
from tui.scans.folder import ScanEntry, held
from tui.scans.scan_text import copy_words, reconstruct_words, recover_words, verify_words, why_not_now
from tui.scans.trash import trash_scan


class ScansScreen(RigScreenBase):
    """All scans, the newest first."""

    NAME = "scans"
    SUMMARY = (
        "Every scan of the folder. Long work runs beside the screen and can be cancelled; "
        "a scan that is being taken is never touched."
    )
    CHANGES = frozenset({"resume"})
    CHANGES_FILES = frozenset({"reprocess", "notes", "trash", "recover", "seal"})
    BINDINGS = [
        Binding("up", "move(-1)", "previous", show=False),
        Binding("down", "move(1)", "next", show=False),
        Binding("pageup", "page(-1)", "page up", show=False),
        Binding("pagedown", "page(1)", "page down", show=False),
        Binding("home", "move(-100000)", "newest", show=False),
        Binding("end", "move(100000)", "oldest", show=False),
        Binding("o,enter", "open", "open", id="scans.open", tooltip="its maps on the reconstruct screen"),
        Binding("v", "verify", "verify", id="scans.verify", tooltip="read every frame and check it"),
        Binding("m", "reprocess", "reprocess", id="scans.reprocess", tooltip="make maps, cloud and report again"),
        Binding("n", "notes", "notes", id="scans.notes", tooltip="specimen, operator, notes, tags"),
        Binding("c", "copy", "copy", id="scans.copy", tooltip="copy it elsewhere and verify the copy"),
        Binding("d", "trash", "trash", id="scans.trash", tooltip="move it to the trash folder; nothing is erased"),
        Binding("r", "resume", "resume", id="scans.resume", tooltip="go on with an interrupted sweep"),
        Binding("R", "recover", "recover", id="scans.recover", tooltip="check and mark a scan whose writer died"),
        Binding("S", "seal", "close", id="scans.seal", tooltip="close an interrupted scan for good"),
        Binding("x", "cancel", "cancel", id="scans.cancel", tooltip="cancel the work on the chosen scan"),
    ]

    def __init__(self, shell: Shell) -> None:
        super().__init__(shell)
        self._list = RowList(empty="reading the folder of scans ...")
        self._detail = ScanDetail((None, ""))
        self._job_lines = JobLines(())
        self._scans = ScanList(self, lambda: self.show_all(self.view))
        self._last: dict[str, str] = {}
        """The result of the last work on each scan."""

    def body(self) -> ComposeResult:
        """The list, the chosen scan, running jobs."""
        yield self._list
        yield self._detail
        yield self._job_lines

    def on_mount(self) -> None:
        """List the folder, again and again."""
        self._scans.begin()

    # ---- what is shown ----

    def show(self, view: RigView) -> None:
        """List, detail, jobs."""
        if self._scans.problem is not None:
            self._list.say_when_empty(
                self._scans.problem or f"no scans in {self._scans.folder}: 1 goes to the scan screen"
            )
        columns, now = columns_of(self._list.content_size.width - 2), datetime.now(UTC)
        header = Text("".join(f"{name:<{cells}}" for name, cells in columns))
        rows = [row_of(entry, self._job_on(entry), columns, now) for entry in self._scans.entries]
        self._list.show(Rows(header, rows, [str(entry.folder) for entry in self._scans.entries]))
        self._list.border_title = self._title()
        entry = self._chosen
        self._detail.border_title = entry.folder.name if entry else "scan"
        self._detail.show((entry, self._last.get(str(entry.folder), "") if entry else ""))
        self._job_lines.show(self.jobs.work)

    def _title(self) -> str:
        if not self._scans.entries:
            return "scans"
        total = sum(entry.size_bytes for entry in self._scans.entries)
        return f"{len(self._scans.entries)} scans, {format_bytes(total)}, {_free(self._scans.folder)} free"

    def on_row_list_moved(self) -> None:
        """Another scan: other things can be done."""
        self.show_all(self.view)

    @property
    def _chosen(self) -> ScanEntry | None:
        key = self._list.chosen
        return next((entry for entry in self._scans.entries if str(entry.folder) == key), None)

    def _job_on(self, entry: ScanEntry) -> Job | None:
        return self.jobs.running_on(str(entry.folder))

    # ---- what can be done ----

    def why_not(self, action: str) -> str:
        """The chosen scan's state decides."""
        entry = self._chosen
        if action in ("move", "page"):
            return ""
        if entry is None:
            return "no scan is chosen"
        job = self._job_on(entry)
        return why_not_now(action, entry, job.title.split()[0] if job else "")

    def action_move(self, rows: int) -> None:
        """Choose another scan."""
        self._list.move(rows)

    def action_page(self, pages: int) -> None:
        """Choose another scan, a page away."""
        self._list.move(pages * self._list.page)

    def action_open(self) -> None:
        """Show its maps."""
        entry = self._chosen
        assert entry is not None
        screen = self.shell.screen_named("reconstruct")
        assert isinstance(screen, ReconstructScreen)
        screen.open_scan(entry.folder)
        self.shell.action_go("reconstruct")

    def action_verify(self) -> None:
        """Read every frame and check it."""
        self._work("verify", ["verify", "--progress", "--json"], verify_words)

    def action_reprocess(self) -> None:
        """Make its maps and cloud again with the settings that the scan recorded."""
        self._work("reprocess", ["reconstruct", "--progress", "--json"], reconstruct_words)

    def action_recover(self) -> None:
        """Check and mark it."""
        self._work("recover", ["recover", "--json"], recover_words)

    def action_seal(self) -> None:
        """Ask, then close it for good."""
        entry = self._chosen
        assert entry is not None
        lines = (f"Close {entry.folder.name} for good?", "Its frames are kept; it can no longer be resumed.")
        seal = ["recover", "--seal", "--json"]
        self.ask(Confirm(lines, "close it"), lambda _yes: self._work("close", seal, recover_words, entry))

    def action_resume(self) -> None:
        """Go on with the sweep; the daemon first checks that light and specimen have not moved."""
        entry = self._chosen
        assert entry is not None
        self.send("resume_scan", path=str(entry.folder))

    def action_cancel(self) -> None:
        """Cancel the work on it."""
        entry = self._chosen
        assert entry is not None
        self.jobs.cancel(self._job_on(entry))

    def action_copy(self) -> None:
        """Ask where to, then copy and verify."""
        entry = self._chosen
        assert entry is not None
        before = str(Path(entry.copies[-1].to).parent) if entry.copies else ""
        help_words = "on another disk; every file is read back and compared"
        field = FormField("dest", "into the folder", before, help=help_words)
        copy = ["copy", "--progress", "--json"]
        form = FormDialog(
            f"copy {entry.folder.name}", [field], lambda texts: parse_folder(texts["dest"]), done="copies and verifies"
        )
        self.ask(form, lambda dest: self._work("copy", copy, copy_words, entry, [dest]))

    def action_notes(self) -> None:
        """Edit its notes."""
        entry = self._chosen
        assert entry is not None
        now = entry.notes
        fields = [
            FormField("specimen", "specimen", now.specimen),
            FormField("operator", "operator", now.operator),
            FormField("notes", "notes", now.notes),
            FormField("tags", "tags", ", ".join(now.tags), help="separated by commas"),
        ]
        form = FormDialog(
            f"notes on {entry.folder.name}", fields, lambda texts: _parse_notes(now, texts), done="saves them"
        )
        self.ask(form, lambda notes: self._in_thread("notes", lambda: _write(entry.folder, notes)))

    def action_trash(self) -> None:
        """Ask, then move it to the trash folder."""
        entry = self._chosen
        assert entry is not None
        kept = "It was copied and verified." if entry.copies else "IT WAS NEVER COPIED ELSEWHERE."
        lines = (f"Move {entry.folder.name} to the trash folder?", f"{kept} Nothing is erased.")
        data_dir = self.shell.options.data_dir
        self.ask(
            Confirm(lines, "move it there"),
            lambda _yes: self._in_thread("trash", lambda: f"moved to {trash_scan(entry.folder.resolve(), data_dir)}"),
        )

    def _in_thread(self, what: str, work: Callable[[], str]) -> None:
        async def run() -> None:
            try:
                self.say(f"{what}: {await asyncio.to_thread(work)}")
            except (SweepscopeError, OSError) as error:
                self.say(f"{what}: {error}", "error")
            self._scans.update()

        self.run_worker(run(), exit_on_error=False)

    def _work(
        self,
        what: str,
        arguments: Sequence[str],
        words: Callable[[dict[str, Any]], str],
        entry: ScanEntry | None = None,
        more: Sequence[str] = (),
    ) -> None:
        """Run a command on a scan, by default the chosen one; ``words`` makes its result readable."""
        entry = entry or self._chosen
        assert entry is not None
        folder, name = str(entry.folder), entry.folder.name

        def ended(job: Job) -> None:
            self._last[folder] = job.end_words()
            if job.result is not None and not job.cancelled:
                self._last[folder] = f"{what}: {words(job.result)}"
                self.say(f"{name}: {self._last[folder]}", "info" if job.ok else "error")
            self._scans.update()

        command = [arguments[0], folder, *more, *arguments[1:]]
        self.jobs.start(f"{what} {name}", command, folder, ended)


def _free(folder: Path) -> str:
    try:
        return format_bytes(shutil.disk_usage(folder).free)
    except OSError:
        return "?"


def _parse_notes(now: Notes, texts: dict[str, str]) -> Notes:
    tags = [tag.strip() for tag in texts["tags"].split(",") if tag.strip()]
    try:
        return msgspec.convert({**msgspec.to_builtins(now), **texts, "tags": tags}, Notes)
    except msgspec.ValidationError as error:
        raise ValueError(str(error)) from None


def _write(folder: Path, notes: Notes) -> str:
    with held(folder):
        write_notes(folder, notes)
    return f"saved beside {folder.name}"
