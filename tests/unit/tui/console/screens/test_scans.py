"""The scans screen: what is offered for which scan, what work comes to, and that nothing happens by accident."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from textual.widgets import Input

from acquire.contract.process.run_dir import FileLock
from acquire.contract.scan_data.dataset_names import OWNER_LOCK_NAME
from tests.fakes.scans.small_scans import make_scan
from tests.fakes.scans.some_maps import write_maps
from tests.unit.tui.console.played_console import PlayedConsole, play
from tests.waiting import DEADLINE_S, Stopwatch
from tui.console import jobs
from tui.console.screens import dialogs, scan_list
from tui.console.screens.dialogs import Confirm, FormDialog
from tui.console.screens.reconstruct import ReconstructScreen
from tui.console.widgets.rows import RowList
from tui.console.widgets.scan_rows import ScanDetail


@pytest.fixture(autouse=True)
def quick(request, monkeypatch):
    """Answers count at once, but where that is the test; the folder is looked at often."""
    monkeypatch.setattr(scan_list, "POLL_S", 0.1)
    monkeypatch.setattr(dialogs, "TYPE_AHEAD_S", 1000.0 if "type_ahead" in request.node.name else 0.0)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three scans: saved (newest), stopped, interrupted."""
    make_scan(tmp_path / "saved", started_utc="2026-01-03T00:00:00Z", points=76_123, specimen="left ear")
    make_scan(tmp_path / "stopped", 5, started_utc="2026-01-02T00:00:00Z")
    make_scan(tmp_path / "cut", 3, seal=False, started_utc="2026-01-01T00:00:00Z")
    return tmp_path


async def listed(console: PlayedConsole, *words: str) -> None:
    await console.until(lambda: all(word in console.shown(RowList) for word in words), f"{words} in the list")


def test_scans_are_listed_with_their_outcome_and_the_chosen_one_in_full(folder):
    async def script(console):
        await console.connect()
        await listed(console, "SAVED", "76 123", "stopped 5/8", "interrupted 3/8")
        assert "specimen: left ear" in console.shown(ScanDetail)
        await console.press("down", "down")
        assert "3 of 8 frames are safe" in console.shown(ScanDetail)

    play(script, screen="scans", data_dir=folder)


def test_a_scan_that_appears_is_seen_without_asking(folder):
    async def script(console):
        await listed(console, "saved")
        make_scan(folder / "newcomer")
        await listed(console, "newcomer")

    play(script, screen="scans", data_dir=folder)


def test_an_empty_folder_and_one_that_cannot_be_read_say_so(tmp_path):
    async def script(console):
        await listed(console, "no scans in")

    play(script, screen="scans", data_dir=tmp_path / "nowhere", size=(160, 50))
    (tmp_path / "file").touch()

    async def broken(console):
        await listed(console, "cannot read the folder of scans")

    play(broken, screen="scans", data_dir=tmp_path / "file", size=(160, 50))


def test_verify_runs_beside_the_screen_and_its_word_stays_with_the_scan(folder):
    async def script(console):
        console.watch_jobs()
        await listed(console, "saved")
        await console.press("v")
        assert console.started == [(["verify", str(folder / "saved"), "--progress", "--json"], str(folder / "saved"))]
        await console.end_job({"ok": True, "committed": 8, "expected": 8})
        assert "verify: 8 of 8 frames are there, all checksums fit" in console.shown(ScanDetail)
        await console.press("down")
        assert "checksums" not in console.shown(ScanDetail)

    play(script, screen="scans", data_dir=folder)


def test_a_scan_that_is_not_sound_is_an_error_in_words(folder):
    async def script(console):
        console.watch_jobs()
        await listed(console, "saved")
        await console.press("v")
        await console.end_job({"ok": False, "problems": ["frames whose pixels changed: 1"]}, exit_status=1)
        assert console.app.state.log.lines[-1].level == "error"
        assert "frames whose pixels changed: 1" in console.shown(ScanDetail)

    play(script, screen="scans", data_dir=folder)


def test_a_real_child_verifies_a_real_scan(folder):
    async def script(console):
        await listed(console, "saved")
        await console.press("v")
        await console.until(lambda: "all checksums fit" in console.log, "the child's word")

    play(script, screen="scans", data_dir=folder)


def test_a_job_that_is_cancelled_says_so(folder):
    async def script(console):
        await listed(console, "saved")
        await console.press("v", "x")
        await console.until(lambda: "verify saved: cancelled" in console.log, "the end")

    play(script, screen="scans", data_dir=folder)


def test_a_running_scan_is_never_touched(folder):
    lock = FileLock(folder / "cut" / OWNER_LOCK_NAME, "a sweep")

    async def script(console):
        console.watch_jobs()
        await listed(console, "running")
        await console.press("end", *"vmncdRS")
        assert console.started == [] and not isinstance(console.app.screen, FormDialog | Confirm)
        assert console.log.count("a sweep runs into this scan") >= 6

    try:
        play(script, screen="scans", data_dir=folder)
    finally:
        lock.release()


def test_resume_is_sent_for_an_interrupted_or_stopped_scan_only(folder):
    async def script(console):
        await console.connect()
        await listed(console, "cut")
        await console.press("r")
        assert console.link.sent == [] and "only an interrupted or stopped scan" in console.log
        await console.press("end", "r")
        assert console.link.sent == [("resume_scan", {"path": str(folder / "cut")})]
        await console.press("up", "r")
        assert console.link.sent[1:] == [("resume_scan", {"path": str(folder / "stopped")})]

    play(script, screen="scans", data_dir=folder)


def test_the_trash_asks_says_whether_a_copy_exists_and_moves(folder):
    async def script(console):
        await listed(console, "stopped")
        await console.press("down", "d")
        assert "IT WAS NEVER COPIED" in console.painted
        await console.press("n")
        assert (folder / "stopped").exists()
        await console.press("d", "y")
        await console.until((folder / ".trash" / "stopped").exists, "it is in the trash")
        await console.until(lambda: "stopped" not in console.shown(RowList), "it is off the list")

    play(script, screen="scans", data_dir=folder)


def test_type_ahead_does_not_trash_a_scan(folder):
    async def script(console):
        await listed(console, "saved")
        await console.pilot.press("d", "y")
        assert isinstance(console.app.screen, Confirm)
        assert (folder / "saved").exists()

    play(script, screen="scans", data_dir=folder)


def test_notes_are_edited_and_seen(folder):
    async def script(console):
        await listed(console, "saved")
        await console.press("n")
        form = console.app.screen
        form.query_one("#field-specimen", Input).value = "right ear"
        form.query_one("#field-tags", Input).value = "a, b"
        await console.press("enter")
        await console.until(lambda: "specimen: right ear" in console.shown(ScanDetail), "the new notes")
        assert "tags: a, b" in console.shown(ScanDetail)

    play(script, screen="scans", data_dir=folder)


def test_copy_needs_a_whole_path_and_starts_the_copying_command(folder):
    async def script(console):
        console.watch_jobs()
        await listed(console, "saved")
        await console.press("c", "x", "enter")
        assert "give the whole path" in console.painted
        console.app.screen.query_one(Input).value = "/mnt/disk"
        await console.press("enter")
        assert console.started[0][0] == ["copy", str(folder / "saved"), "/mnt/disk", "--progress", "--json"]
        await console.end_job({"to": "/mnt/disk/saved", "files": 2})
        assert "2 files verified by checksum" in console.log

    play(script, screen="scans", data_dir=folder)


def test_open_shows_the_maps_of_the_chosen_scan(folder):
    async def script(console):
        await listed(console, "saved")
        await console.press("o")
        assert "it has no maps yet: m makes them" in console.log
        write_maps(folder / "saved")
        watch = Stopwatch()
        while not isinstance(console.screen, ReconstructScreen):
            assert watch.elapsed_s < DEADLINE_S, "the maps are not noticed"
            await console.press("o")
        await console.until(lambda: "saved (maps.h5)" in console.painted, "the maps")

    play(script, screen="scans", data_dir=folder)


def test_ascii_lists_have_no_other_signs(folder):
    async def script(console):
        await listed(console, "saved")
        assert console.shown(RowList).isascii() and console.shown(ScanDetail).isascii()

    play(script, screen="scans", data_dir=folder, ascii_only=True)


def test_a_read_only_console_looks_but_changes_no_scan(folder):
    async def script(console):
        console.watch_jobs()
        await listed(console, "saved")
        await console.press(*"mndRS")
        assert console.started == [] and not isinstance(console.app.screen, FormDialog | Confirm)
        await console.press("v")
        assert console.started[0][0][0] == "verify"

    play(script, screen="scans", data_dir=folder, read_only=True)


def test_leaving_while_work_runs_is_asked_about_and_ends_it(folder, monkeypatch):
    monkeypatch.setattr(jobs, "PROGRAM", [sys.executable, "-S", "-c", "import time; time.sleep(60)"])
    apps = []

    async def script(console):
        apps.append(console.app)
        await listed(console, "saved")
        await console.press("v", "q")
        assert isinstance(console.app.screen, Confirm) and "verify saved" in console.painted
        await console.press("n")
        assert console.app.jobs.running_on(str(folder / "saved"))
        await console.press("q", "y")

    play(script, screen="scans", data_dir=folder)
    assert apps[0].jobs.running == []
