"""The scans screen: the folder of scans, and what can be done with one; nothing here touches a scan that is owned."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Callable
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
from tui.console.link.rig_view import RigView
from tui.console.screens.base import RigScreenBase
from tui.console.screens.dialogs import Confirm, Field, Form
from tui.console.screens.reconstruct import ReconstructScreen
from tui.console.widgets.job_lines import JobLines
from tui.console.widgets.rows import RowList
from tui.console.widgets.scan_rows import ScanDetail, columns_of, row_of
from tui.processes.child_jobs import Job
from tui.scans.folder import ScanEntry, ScanFolder, held
from tui.scans.scan_text import copy_words, reconstruct_words, recover_words, verify_words, why_not_now
from tui.scans.trash import trash_scan

CHANGES_SCANS = frozenset({"reprocess", "notes", "trash", "recover", "seal"})
LOOK_S = 2.0
"""How often the folder is looked at while this screen is in view."""


class ScansScreen(RigScreenBase):
    """All scans, the newest first."""

    NAME = "scans"
    SUMMARY = (
        "Every scan of the folder. Long work runs beside the screen and can be cancelled; "
        "a scan that is running is never touched."
    )
    CHANGES = frozenset({"resume"})
    BINDINGS = [
        Binding("up", "move(-1)", "previous", show=False),
        Binding("down", "move(1)", "next", show=False),
        Binding("pageup", "page(-1)", "page up", show=False),
        Binding("pagedown", "page(1)", "page down", show=False),
        Binding("home", "move(-100000)", "newest", show=False),
        Binding("end", "move(100000)", "oldest", show=False),
        Binding("o,enter", "open", "open", id="scans.open", tooltip="its maps on the reconstruct screen"),
        Binding("v", "verify", "verify", id="scans.verify", tooltip="read every frame and check it"),
        Binding("m", "reprocess", "reprocess", id="scans.reprocess", tooltip="maps, cloud and report again"),
        Binding("n", "notes", "notes", id="scans.notes", tooltip="specimen, operator, notes, tags"),
        Binding("c", "copy", "copy", id="scans.copy", tooltip="copy it elsewhere and verify the copy"),
        Binding("d", "trash", "trash", id="scans.trash", tooltip="move it to the trash folder; nothing is erased"),
        Binding("r", "resume", "resume", id="scans.resume", tooltip="go on with an interrupted sweep"),
        Binding("R", "recover", "recover", id="scans.recover", tooltip="check and mark a scan whose owner died"),
        Binding("S", "seal", "close", id="scans.seal", tooltip="close an interrupted scan for good"),
        Binding("x", "cancel", "cancel", id="scans.cancel", tooltip="end the work on the chosen scan"),
    ]

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(ascii_only=ascii_only)
        self._list = RowList(id="scans", ascii_only=ascii_only, empty="looking at the folder of scans ...")
        self._detail = ScanDetail(ascii_only=ascii_only)
        self._jobs = JobLines(ascii_only=ascii_only)
        self._entries: list[ScanEntry] = []
        self._folder: ScanFolder | None = None
        self._looking = False
        self._last: dict[str, str] = {}

    def body(self) -> ComposeResult:
        """The list, the chosen one, what runs."""
        yield self._list
        yield self._detail
        yield self._jobs

    def on_mount(self) -> None:
        """Look at the folder, again and again."""
        self._folder = ScanFolder(self.shell.options.data_dir)
        self.set_interval(LOOK_S, self._look_again)
        self._look()

    def _look_again(self) -> None:
        if self.is_current:
            self._look()

    def _look(self) -> None:
        if not self._looking and self._folder is not None:
            self._looking = True
            self.run_worker(self._looked(self._folder), exit_on_error=False)

    async def _looked(self, folder: ScanFolder) -> None:
        try:
            self._entries = await asyncio.to_thread(folder.look)
            self._list.say_when_empty(f"no scans in {folder.data_dir}: 1 goes to the scan screen")
        except (SweepscopeError, OSError) as error:
            self._list.say_when_empty(str(error))
        finally:
            self._looking = False
        self.show_all(self.view)

    # ---- what is seen ----

    def show(self, view: RigView) -> None:
        """List, detail, jobs."""
        board, now = self.shell.jobs.board, datetime.now(UTC)
        columns = columns_of(self._list.content_size.width - 2)
        header = Text("".join(f"{name:<{cells}}" for name, cells in columns))
        rows = [
            row_of(entry, board.running_on(str(entry.folder)), columns, now, ascii_only=self.ascii_only)
            for entry in self._entries
        ]
        self._list.show(header, rows, [str(entry.folder) for entry in self._entries])
        self._list.border_title = self._title()
        self._show_detail()
        self._jobs.show(self.shell.jobs.work)

    def _title(self) -> str:
        if not self._entries or self._folder is None:
            return "scans"
        total = sum(entry.size_bytes for entry in self._entries)
        return f"{len(self._entries)} scans, {format_bytes(total)}, {_free(self._folder.data_dir)} free"

    def _show_detail(self) -> None:
        entry = self._chosen
        self._detail.entry = entry
        self._detail.border_title = entry.folder.name if entry else "scan"
        self._detail.last_words = self._last.get(str(entry.folder), "") if entry else ""
        self._detail.changed()

    def on_row_list_moved(self) -> None:
        """Another scan: other things can be done."""
        self.show_all(self.view)

    @property
    def _chosen(self) -> ScanEntry | None:
        key = self._list.chosen
        return next((entry for entry in self._entries if str(entry.folder) == key), None)

    # ---- what can be done ----

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """A read-only console changes no scan either."""
        if action in CHANGES_SCANS and self.shell.read_only:
            return False
        return super().check_action(action, parameters)

    def why_not(self, action: str) -> str:
        """The chosen scan's state decides."""
        entry = self._chosen
        if action in ("move", "page"):
            return ""
        if entry is None:
            return "no scan is chosen"
        return why_not_now(action, entry, self.shell.jobs.board.running_on(str(entry.folder)))

    def action_move(self, rows: int) -> None:
        """Choose another scan."""
        self._list.move(rows)

    def action_page(self, pages: int) -> None:
        """Choose one that is further away."""
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
        """Read every frame."""
        self._job("verify", ["verify", "--progress", "--json"], verify_words)

    def action_reprocess(self) -> None:
        """Make its maps and cloud again as the scan recorded it."""
        self._job("reprocess", ["reconstruct", "--progress", "--json"], reconstruct_words)

    def action_recover(self) -> None:
        """Check and mark it."""
        self._job("recover", ["recover", "--json"], recover_words)

    def action_seal(self) -> None:
        """Ask, then close it for good."""
        entry = self._chosen
        assert entry is not None
        lines = (f"Close {entry.folder.name} for good?", "What was taken is kept; it can no longer be resumed.")
        seal = ["recover", "--seal", "--json"]
        self._ask(Confirm(lines, "close it"), lambda: self._job("close", seal, recover_words, entry))

    def action_resume(self) -> None:
        """Go on with the sweep; the daemon proves first that light and specimen are where they were."""
        entry = self._chosen
        assert entry is not None
        self.send("resume_scan", path=str(entry.folder))

    def action_cancel(self) -> None:
        """End the work on it."""
        entry = self._chosen
        job = self.shell.jobs.board.running_on(str(entry.folder)) if entry else None
        if job is not None:
            self.shell.jobs.cancel(job)

    def action_copy(self) -> None:
        """Ask where to, then copy and verify."""
        entry = self._chosen
        assert entry is not None
        before = str(Path(entry.copies[-1].to).parent) if entry.copies else ""
        field = Field("dest", "into the folder", before, help="on another disk; every file is read back and compared")

        def copy(dest: str | None) -> None:
            if dest:
                self._job("copy", ["copy", "--progress", "--json"], copy_words, entry, [dest])

        form = Form(f"copy {entry.folder.name}", [field], _folder_of, done="copies and verifies")
        self.shell.push_screen(form, copy)

    def action_notes(self) -> None:
        """Edit what people say about it."""
        entry = self._chosen
        assert entry is not None
        now = entry.notes
        fields = [
            Field("specimen", "specimen", now.specimen, words=True),
            Field("operator", "operator", now.operator, words=True),
            Field("notes", "notes", now.notes, words=True),
            Field("tags", "tags", ", ".join(now.tags), words=True, help="with commas between them"),
        ]

        def write(notes: Notes | None) -> None:
            if notes is not None:
                self.run_worker(self._in_thread(lambda: _write(entry.folder, notes), "notes"), exit_on_error=False)

        form = Form(f"notes on {entry.folder.name}", fields, lambda texts: _notes(now, texts), done="keeps them")
        self.shell.push_screen(form, write)

    def action_trash(self) -> None:
        """Ask, then move it away."""
        entry = self._chosen
        assert entry is not None
        kept = "It was copied and verified." if entry.copies else "IT WAS NEVER COPIED ELSEWHERE."
        lines = (f"Move {entry.folder.name} to the trash folder?", f"{kept} Nothing is erased.")
        data_dir = self.shell.options.data_dir

        def move() -> None:
            work = self._in_thread(lambda: f"in {trash_scan(entry.folder.resolve(), data_dir)} now", "trash")
            self.run_worker(work, exit_on_error=False)

        self._ask(Confirm(lines, "move it there"), move)

    def _ask(self, question: Confirm, then: Callable[[], Any]) -> None:
        self.shell.push_screen(question, lambda yes: then() if yes else None)

    async def _in_thread(self, work: Callable[[], str], what: str) -> None:
        try:
            self.say(f"{what}: {await asyncio.to_thread(work)}")
        except (SweepscopeError, OSError) as error:
            self.say(f"{what}: {error}", "error")
        self._look()

    def _job(
        self,
        what: str,
        arguments: list[str],
        words: Callable[[dict[str, Any]], str],
        entry: ScanEntry | None = None,
        more: list[str] | None = None,
    ) -> None:
        entry = entry or self._chosen
        assert entry is not None
        folder = str(entry.folder)

        def ended(job: Job) -> None:
            told = words(job.result) if job.result is not None and not job.cancelled else job.end_words()
            self._last[folder] = f"{what}: {told}" if job.result is not None and not job.cancelled else told
            if job.result is not None and not job.cancelled:
                self.say(f"{entry.folder.name}: {self._last[folder]}", "info" if job.ok else "error")
            self._look()

        command = [arguments[0], folder, *(more or []), *arguments[1:]]
        self.shell.jobs.start(f"{what} {entry.folder.name}", command, folder, ended)


def _free(folder: Path) -> str:
    try:
        return format_bytes(shutil.disk_usage(folder).free)
    except OSError:
        return "?"


def _folder_of(texts: dict[str, str]) -> str:
    dest = Path(texts["dest"]).expanduser()
    if not texts["dest"] or not dest.is_absolute():
        raise ValueError("give the whole path of a folder that is there, for example /mnt/disk/scans")
    return str(dest)


def _notes(now: Notes, texts: dict[str, str]) -> Notes:
    tags = [tag.strip() for tag in texts["tags"].split(",") if tag.strip()]
    try:
        return msgspec.convert({**msgspec.to_builtins(now), **texts, "tags": tags}, Notes)
    except msgspec.ValidationError as error:
        raise ValueError(str(error)) from None


def _write(folder: Path, notes: Notes) -> str:
    with held(folder):
        write_notes(folder, notes)
    return f"kept beside {folder.name}"
