"""The folder of scans: what is said of each, notes, verified copies, the trash, and what somebody owns."""

from __future__ import annotations

import io
import json
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import pytest

from acquire.contract.errors import AlreadyRunningError, ScanFileError
from acquire.contract.process.run_dir import FileLock
from acquire.contract.scan_data.dataset_names import OWNER_LOCK_NAME
from acquire.contract.scan_data.notes import Notes, notes_of, write_notes
from acquire.writer.verify import info
from tests.fakes.scans.small_scans import make_scan
from tui.cli import run
from tui.scans import copies
from tui.scans.copies import copies_of, copy_scan
from tui.scans.folder import ScanFolder, read_entry, scan_folder
from tui.scans.trash import trash_scan

NOW = datetime(2026, 1, 4, 3, 4, 5, tzinfo=UTC)
PLANE = {"light_plane": {"kind": "translating"}, "valid_for": {"created_utc": "2025-12-21T03:04:05Z"}}


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != OWNER_LOCK_NAME}


def test_scans_are_listed_newest_first_with_outcome_points_ages_and_calibration(tmp_path):
    make_scan(tmp_path / "old", started_utc="2026-01-01T00:00:00Z")
    make_scan(tmp_path / "new", frames=5, points=1234, calibration=PLANE, specimen="left ear")
    new, old = ScanFolder(tmp_path).look()
    assert (new.folder.name, new.state, new.outcome_words, new.points) == ("new", "sealed", "stopped 5/8", 1234)
    assert (new.age_words(NOW), new.calibration_words, new.notes.specimen) == ("2 days", "12 days", "left ear")
    assert (old.outcome_words, old.points, old.calibration_words) == ("SAVED", None, "none")
    assert "no cloud" in "\n".join(old.lines()) and "12 days" in "\n".join(new.lines())


def test_a_scan_that_somebody_owns_is_running_and_one_whose_owner_died_is_interrupted(tmp_path):
    folder = make_scan(tmp_path / "a", frames=3, seal=False)
    assert read_entry(folder).outcome_words == "interrupted 3/8"
    lock = FileLock(folder / OWNER_LOCK_NAME, "a sweep")
    assert read_entry(folder).state == "running"
    lock.release()


def test_a_scan_that_cannot_be_read_is_listed_with_the_reason_and_the_others_too(tmp_path):
    make_scan(tmp_path / "good")
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "scan.h5").write_bytes(b"no HDF5")
    (tmp_path / "not-a-scan").mkdir()
    (tmp_path / "stray.txt").touch()
    found = {entry.folder.name: entry for entry in ScanFolder(tmp_path).look()}
    assert set(found) == {"good", "bad"}
    assert found["bad"].state == "unreadable" and "not a readable scan file" in found["bad"].problem


def test_what_did_not_change_is_not_read_again_and_what_did_is(tmp_path, monkeypatch):
    folder = make_scan(tmp_path / "a")
    scans = ScanFolder(tmp_path)
    (first,) = scans.look()
    assert scans.look()[0] is first
    write_notes(folder, Notes(specimen="ear"))
    assert scans.look()[0].notes.specimen == "ear"


def test_a_folder_of_scans_that_is_not_there_yet_holds_none(tmp_path):
    assert ScanFolder(tmp_path / "nowhere").look() == []


def test_notes_are_kept_beside_the_scan_and_the_scan_is_untouched(tmp_path):
    folder = make_scan(tmp_path / "a", operator="anna", tags=["x"])
    before = (folder / "scan.h5").read_bytes()
    assert notes_of(folder, {"operator": "anna", "tags": ["x"]}).tags == ("x",)
    assert run(["notes", str(folder), "--notes", "the left one", "--tag", "y", "--tag", "z"]) == 0
    found = read_entry(folder).notes
    assert (found.operator, found.notes, found.tags) == ("anna", "the left one", ("y", "z"))
    assert found.edited_utc.endswith("Z")
    assert (folder / "scan.h5").read_bytes() == before
    assert info(folder).user["notes"] == "the left one"


def test_notes_that_are_too_long_or_broken_are_refused_and_what_was_there_stays(tmp_path, capsys):
    folder = make_scan(tmp_path / "a")
    write_notes(folder, Notes(notes="short"))
    assert run(["notes", str(folder), "--notes", "x" * 5000]) == 1
    assert read_entry(folder).notes.notes == "short"
    (folder / "notes.json").write_text("{")
    assert run(["notes", str(folder)]) == 1
    assert "fix it, or remove it" in capsys.readouterr().err
    assert read_entry(folder).state == "unreadable"


def test_a_copy_is_equal_verified_marked_and_can_be_checked_without_us(tmp_path, capsys):
    folder = make_scan(tmp_path / "scans" / "a", points=5)
    dest = tmp_path / "disk"
    dest.mkdir()
    assert run(["copy", str(folder), str(dest), "--json", "--progress"]) == 0
    said = capsys.readouterr()
    made = json.loads(said.out)
    assert made["to"] == str(dest / "a") and json.loads(said.err.splitlines()[-1])["done"] == 2 * made["nbytes"]
    copied = contents(dest / "a")
    sums = copied.pop("SHA256SUMS")
    assert copied == {name: data for name, data in contents(folder).items() if name != "copies.json"}
    assert sums.count(b"\n") == made["files"] == len(copied)
    subprocess.run(["sha256sum", "--quiet", "-c", "SHA256SUMS"], cwd=dest / "a", check=True)
    assert [copy.to for copy in copies_of(folder)] == [str(dest / "a")]
    assert read_entry(folder).copies[0].words().endswith("verified by checksum")


def test_a_copy_that_arrives_damaged_is_refused_and_nothing_is_left_of_it(tmp_path, monkeypatch):
    folder, dest = make_scan(tmp_path / "scans" / "a"), tmp_path / "disk"
    dest.mkdir()
    before = contents(folder)

    def spoil(_source: Path, target: Path) -> None:
        data = bytearray(target.read_bytes())
        data[-1] ^= 1
        target.write_bytes(data)

    monkeypatch.setattr(copies.shutil, "copystat", spoil)  # the last that happens to a file before it is verified
    with pytest.raises(ScanFileError, match="arrived damaged"):
        copy_scan(folder, dest)
    assert list(dest.iterdir()) == [] and contents(folder) == before


def test_a_copy_that_is_interrupted_leaves_nothing(tmp_path):
    folder, dest = make_scan(tmp_path / "scans" / "a"), tmp_path / "disk"
    dest.mkdir()

    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        copy_scan(folder, dest, interrupt)
    assert list(dest.iterdir()) == [] and copies_of(folder) == ()


def test_copies_to_impossible_places_are_refused_before_anything_is_written(tmp_path, monkeypatch):
    folder = make_scan(tmp_path / "scans" / "a")
    for dest, why in (
        (tmp_path / "nowhere", "is not a folder"),
        (folder, "within the scan itself"),
        (tmp_path / "scans", "is there already"),
    ):
        with pytest.raises(ScanFileError, match=why):
            copy_scan(folder, dest)
    monkeypatch.setattr(copies.shutil, "disk_usage", lambda _: type("Usage", (), {"free": 10})())
    with pytest.raises(ScanFileError, match="make room"):
        copy_scan(folder, tmp_path)
    (folder / "sub").mkdir()
    with pytest.raises(ScanFileError, match="no file of a scan"):
        copy_scan(folder, tmp_path)


def test_trash_without_an_answer_moves_nothing_and_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("SWEEPSCOPE_STORAGE__DATA_DIR", str(tmp_path))
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    folder = make_scan(tmp_path / "a")
    assert run(["trash", str(folder)]) == 130 and folder.is_dir()
    assert "sweepscope: no yes: nothing was done" in capsys.readouterr().err


def test_the_trash_keeps_everything_and_takes_a_second_scan_of_the_same_name(tmp_path, monkeypatch):
    monkeypatch.setenv("SWEEPSCOPE_STORAGE__DATA_DIR", str(tmp_path))
    folder = make_scan(tmp_path / "a")
    before = contents(folder)
    assert run(["trash", str(folder), "--yes"]) == 0
    assert not folder.exists() and contents(tmp_path / ".trash" / "a") == before
    again = trash_scan(make_scan(tmp_path / "a"), tmp_path)
    assert again.name.startswith("a-") and contents(tmp_path / ".trash" / "a") == before
    assert ScanFolder(tmp_path).look() == []


def test_only_scans_of_the_folder_can_be_trashed_and_never_the_folder_of_a_lone_file(tmp_path):
    elsewhere = make_scan(tmp_path / "elsewhere" / "a")
    with pytest.raises(ScanFileError, match="remove it by hand"):
        trash_scan(elsewhere, tmp_path / "scans")
    (elsewhere / "scan.h5").rename(elsewhere / "frog.h5")
    with pytest.raises(ScanFileError, match="is not the folder of a scan"):
        scan_folder(elsewhere / "frog.h5")


@pytest.mark.parametrize("command", [["copy", "DEST"], ["trash", "--yes"], ["notes", "--notes", "x"]])
def test_a_scan_that_somebody_owns_is_never_touched(tmp_path, capsys, monkeypatch, command):
    monkeypatch.setenv("SWEEPSCOPE_STORAGE__DATA_DIR", str(tmp_path / "scans"))
    folder = make_scan(tmp_path / "scans" / "a", frames=3, seal=False)
    (tmp_path / "DEST").mkdir()
    before = contents(folder)
    lock = FileLock(folder / OWNER_LOCK_NAME, "a sweep")
    try:
        arguments = [str(tmp_path / "DEST") if part == "DEST" else part for part in command[1:]]
        assert run([command[0], str(folder), *arguments]) == 1
    finally:
        lock.release()
    assert "already running (pid" in capsys.readouterr().err
    assert contents(folder) == before and list((tmp_path / "DEST").iterdir()) == []


def test_the_list_on_the_command_line_is_a_table_or_json(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("SWEEPSCOPE_STORAGE__DATA_DIR", str(tmp_path))
    assert run(["scans"]) == 0
    assert "no scans in" in capsys.readouterr().out
    make_scan(tmp_path / "a", points=77)
    assert run(["scans"]) == 0
    assert "SAVED" in (line := capsys.readouterr().out) and "77 points" in line
    assert run(["scans", "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["scans"]
    assert (found["outcome"], found["committed"], found["points"]) == ("complete", 8, 77)
    assert run(["scans", str(tmp_path / "nowhere")]) == 1


def test_work_on_an_owned_scan_names_the_owner(tmp_path):
    folder = make_scan(tmp_path / "a")
    lock = FileLock(folder / OWNER_LOCK_NAME, "a sweep")
    with pytest.raises(AlreadyRunningError, match=r"other work on a, is already running \(pid \d+\)"):
        trash_scan(folder, tmp_path)
    lock.release()
