"""Recovering: what nobody owns is verified and made honest, what somebody owns is left alone, twice is as once."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from acquire.contract.process.run_dir import FileLock
from acquire.contract.scan_data.checksums import frame_crc32
from acquire.contract.scan_data.dataset_names import NO_SCAN_NAMES, OWNER_LOCK_NAME, FrameStatus
from acquire.contract.scan_data.reader import ScanReader
from acquire.contract.states import Outcome
from acquire.writer.recover import Recovered, RecoverOptions, recover
from acquire.writer.scan_file import ScanFile, create_scan
from acquire.writer.verify import verify
from tests.fakes.scans.frames import image_of, pixels_of, start_of
from tui.cli import run

COUNT = 8


def begin(folder: Path, frames: int, count: int = COUNT) -> ScanFile:
    start = start_of(folder, count, scan_uid=folder.name)
    scan = create_scan(folder, start)
    for frame_index in range(frames):
        pixels = pixels_of(frame_index, count, start.format)
        scan.write_frame(image_of(frame_index, pixels, start), pixels)
    (folder / OWNER_LOCK_NAME).write_text("4242\n")
    return scan


def spoil(scan: Path, frame_index: int) -> None:
    with ScanReader(scan) as reader:
        path, offset = reader.layout.path, reader.layout.frame_offset(frame_index)
    with path.open("r+b") as file:
        file.seek(offset)
        file.write(b"\xff\x00\xff")


def everything_in(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir()) if p.name != OWNER_LOCK_NAME}


def one(where: Path, **options: bool) -> Recovered:
    (found,) = recover(where, RecoverOptions(**options))
    return found


def test_a_scan_whose_owner_died_is_marked_as_interrupted_and_says_why(tmp_path: Path) -> None:
    begin(tmp_path / "a", 5).close()
    found = one(tmp_path)
    assert (found.state, found.outcome, found.committed, found.expected) == ("interrupted", "interrupted", 5, COUNT)
    with ScanReader(tmp_path / "a") as reader:
        assert reader.outcome == Outcome.INTERRUPTED and "pid 4242" in str(reader.scalar("reason"))
    assert "5 of 8 frames are safe" in found.words()


def test_doing_it_twice_is_doing_it_once(tmp_path: Path) -> None:
    begin(tmp_path / "a", 5).close()
    one(tmp_path)
    before = everything_in(tmp_path / "a")
    assert one(tmp_path).state == "interrupted"
    assert everything_in(tmp_path / "a") == before


def test_a_scan_that_somebody_owns_is_left_alone(tmp_path: Path) -> None:
    begin(tmp_path / "a", 5).close()
    lock = FileLock(tmp_path / "a" / OWNER_LOCK_NAME, "a sweep")
    before = everything_in(tmp_path / "a")
    found = one(tmp_path, seal=True, compact=True)
    lock.release()
    assert found.state == "in use" and f"pid {os.getpid()}" in found.words()
    assert everything_in(tmp_path / "a") == before


def test_a_damaged_frame_is_found_marked_and_named(tmp_path: Path) -> None:
    scan = begin(tmp_path / "a", 5)
    scan.sync()
    scan.close()
    spoil(tmp_path / "a", 2)
    found = one(tmp_path)
    assert found.damaged == (2,) and "frames 2" in found.words() and found.committed == 4
    with ScanReader(tmp_path / "a") as reader:
        assert reader.status()[2] == FrameStatus.DAMAGED and reader.scalar("durable_count") == 2


NO_PID = 2**22 + 1
"""Larger than any pid of Linux."""


def test_what_a_dead_writer_had_half_made_is_removed(tmp_path: Path) -> None:
    begin(tmp_path / "a", 1).close()
    (tmp_path / "a" / ".creating-a").write_bytes(b"half")
    (tmp_path / "a" / f".maps.h5.{NO_PID}.tmp").write_bytes(b"half")
    one(tmp_path)
    assert {path.name for path in (tmp_path / "a").iterdir()} == {"scan.partial.h5", OWNER_LOCK_NAME}


def test_results_that_are_being_written_are_no_leftovers(tmp_path: Path) -> None:
    begin(tmp_path / "a", 1).close()
    maps = tmp_path / "a" / f".maps.h5.{os.getpid()}.tmp"
    maps.write_bytes(b"half")
    one(tmp_path)
    assert maps.exists()


def test_a_folder_in_which_no_scan_was_ever_made_goes(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / OWNER_LOCK_NAME).write_text("1\n")
    (tmp_path / "a" / ".creating-u").write_bytes(b"half")
    for name in NO_SCAN_NAMES:
        (tmp_path / "a" / name).write_text("1\n")
    assert one(tmp_path).state == "no scan"
    assert not (tmp_path / "a").exists()


def test_a_folder_with_something_of_the_operators_stays(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / OWNER_LOCK_NAME).write_text("1\n")
    (tmp_path / "a" / "notes.txt").write_text("mine")
    one(tmp_path)
    assert (tmp_path / "a" / "notes.txt").read_text() == "mine"


def test_a_torn_file_is_named_and_left_as_it_is_and_the_others_are_looked_after(tmp_path: Path) -> None:
    begin(tmp_path / "a", 3).close()
    begin(tmp_path / "b", 3).close()
    torn = tmp_path / "a" / "scan.partial.h5"
    os.truncate(torn, torn.stat().st_size // 2)
    before = everything_in(tmp_path / "a")
    found = list(recover(tmp_path))
    assert [item.state for item in found] == ["unreadable", "interrupted"]
    assert everything_in(tmp_path / "a") == before


def test_a_sealing_that_was_cut_off_is_brought_to_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scan = begin(tmp_path / "a", COUNT)
    monkeypatch.setattr(ScanFile, "_rename", lambda _self: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        scan.seal(Outcome.COMPLETE, "all well")
    monkeypatch.undo()
    scan.close()
    found = one(tmp_path)
    assert (found.state, found.outcome) == ("sealed", "complete")
    with ScanReader(tmp_path / "a" / "scan.h5") as reader:
        assert reader.scalar("reason") == "all well"


def test_a_cut_off_sealing_of_a_scan_with_a_damaged_frame_is_not_called_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan = begin(tmp_path / "a", COUNT)
    monkeypatch.setattr(ScanFile, "_rename", lambda _self: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        scan.seal(Outcome.COMPLETE)
    monkeypatch.undo()
    scan.close()
    spoil(tmp_path / "a", 3)
    found = one(tmp_path)
    assert (found.state, found.outcome, found.damaged) == ("interrupted", "interrupted", (3,))


@pytest.mark.parametrize(("frames", "outcome"), [(5, "aborted"), (COUNT, "complete")])
def test_seal_closes_an_interrupted_scan_for_good(tmp_path: Path, frames: int, outcome: str) -> None:
    begin(tmp_path / "a", frames).close()
    found = one(tmp_path, seal=True)
    assert (found.state, found.outcome, found.committed) == ("sealed", outcome, frames)
    assert one(tmp_path, seal=True).outcome == outcome


def test_compact_gives_back_what_was_reserved_and_keeps_every_frame(tmp_path: Path) -> None:
    begin(tmp_path / "a", 3, count=200).close()
    found = one(tmp_path, seal=True, compact=True)
    assert found.freed_bytes > 150 * 64 * 48
    with ScanReader(tmp_path / "a") as reader:
        for frame_index in range(3):
            assert frame_crc32(reader.frame(frame_index)) == reader.field("crc32")[frame_index]
        assert reader.outcome == "aborted" and reader.count == 200
    assert one(tmp_path, compact=True).freed_bytes == 0


def test_at_start_up_only_scans_that_call_themselves_running_are_read(tmp_path: Path) -> None:
    begin(tmp_path / "a", 5).close()
    assert len(list(recover(tmp_path, RecoverOptions(begun_only=True)))) == 1
    assert list(recover(tmp_path, RecoverOptions(begun_only=True))) == []


def test_a_sweep_that_died_before_its_first_frame_is_closed_and_gives_its_space_back(tmp_path: Path) -> None:
    begin(tmp_path / "a", 0, count=200).close()
    found = one(tmp_path)
    assert (found.state, found.outcome, found.committed) == ("sealed", "aborted", 0)
    assert found.freed_bytes > 150 * 64 * 48 and "nothing to resume" in found.words()


def killed_at(call: int, work: Callable[[], None]) -> bool:
    """Run ``work`` in a process that dies by SIGKILL at its n-th call into the disk; True if it died."""
    pid = os.fork()
    if pid == 0:
        _die_at_nth_disk_call(call)
        work()
        os._exit(0)
    return os.waitpid(pid, 0)[1] != 0


def _die_at_nth_disk_call(nth: int) -> None:
    from acquire.writer import frame_store as scan_store
    from acquire.writer import recover as module
    from acquire.writer import scan_file

    calls = []

    def deadly(real: Callable[..., object]) -> Callable[..., object]:
        def call(*args: object, **kwargs: object) -> object:
            calls.append(1)
            if len(calls) == nth:
                os.kill(os.getpid(), 9)
            return real(*args, **kwargs)

        return call

    for owner, name in (
        (scan_store, "write_at"),
        (scan_file, "write_at"),
        (scan_file, "rename_new"),
        (scan_file, "sync"),
        (module, "punch"),
        (os, "fdatasync"),
        (os, "fsync"),
    ):
        setattr(owner, name, deadly(getattr(owner, name)))


def test_recover_killed_at_every_one_of_its_steps_is_finished_by_the_next(tmp_path: Path) -> None:
    died, call = True, 0
    while died:
        call += 1
        folder = tmp_path / f"s{call}"
        begin(folder, 5).close()
        spoil(folder, 1)
        died = killed_at(call, lambda folder=folder: [*recover(folder, RecoverOptions(seal=True, compact=True))])
        found = one(folder, seal=True, compact=True)
        assert (found.state, found.outcome, found.committed) == ("sealed", "aborted", 4), f"killed at call {call}"
        assert not (folder / "scan.partial.h5").exists()
    assert call > 10


def test_going_on_after_a_stop_killed_at_every_step_leaves_the_scan_stopped_or_resumable(tmp_path: Path) -> None:
    died, call = True, 0
    while died:
        call += 1
        folder = tmp_path / f"s{call}"
        with closing(begin(folder, 5)) as scan:
            scan.seal(Outcome.STOPPED)
        died = killed_at(call, lambda folder=folder: ScanFile.reopen(folder).close())
        found = one(folder)
        assert (found.state, found.outcome) in (("sealed", "stopped"), ("interrupted", "interrupted")), call
        assert found.committed == 5 and verify(folder).committed == 5
    assert call > 3


def test_the_command_looks_after_a_folder_of_scans_and_says_what_it_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    begin(tmp_path / "a", 5).close()
    assert run(["recover", str(tmp_path)]) == 0
    assert "interrupted: 5 of 8 frames are safe" in capsys.readouterr().out
    os.truncate(tmp_path / "a" / "scan.partial.h5", 100)
    assert run(["recover", str(tmp_path), "--json"]) == 1
    (scan,) = json.loads(capsys.readouterr().out)["scans"]
    assert scan["state"] == "unreadable" and scan["detail"].startswith("left as it is")


def test_the_command_refuses_a_folder_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["recover", "/nonexistent/scans"]) == 1
    assert "does not exist" in capsys.readouterr().err
