"""The scan file: what was committed stays, what does not fit is refused, whatever happens in between."""

from __future__ import annotations

import errno
import os
import resource
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest

from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import FrameFormat, Start
from acquire.contract.scan_data.dataset_names import CREATING_PREFIX, FrameStatus
from acquire.contract.scan_data.reader import ScanReader
from acquire.contract.states import Outcome
from acquire.writer import scan_file
from acquire.writer.create_file import creating_path
from acquire.writer.disk import DiskError, DiskFullError
from acquire.writer.frame_store import FrameRefusedError
from acquire.writer.recover import RecoverOptions, recover
from acquire.writer.scan_file import ScanExistsError, ScanFile, ScanIncompleteError, create_scan
from acquire.writer.verify import verify
from tests.fakes.scans.frames import image_of, pixels_of, start_of

COUNT = 6


@pytest.fixture
def start(tmp_path: Path) -> Start:
    return start_of(tmp_path / "scan", COUNT)


@pytest.fixture
def scan(start: Start) -> Iterator[ScanFile]:
    made = create_scan(Path(start.path), start)
    yield made
    made.close()


def write(scan: ScanFile, start: Start, frame_index: int, seed: int = 0, **changed: object) -> str:
    pixels = pixels_of(frame_index, COUNT, start.format, seed)
    return scan.write_frame(image_of(frame_index, pixels, start, **changed), pixels)


def fill(scan: ScanFile, start: Start) -> None:
    for frame_index in range(COUNT):
        write(scan, start, frame_index)


@contextmanager
def file_size_limit(size_bytes: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


# ---- creation ----


def test_a_new_scan_opens_with_plain_h5py_and_has_nothing_committed(scan: ScanFile) -> None:
    with h5py.File(scan.path) as file:
        assert file["/entry/data/data"].shape == (COUNT, 48, 64)
        assert not file["/entry/data/status"][:].any()
        assert file["/entry/outcome"][()] == b"running"


def test_the_default_plot_resolves_by_the_nexus_conventions(scan: ScanFile) -> None:
    with h5py.File(scan.path) as file:
        entry = file[file.attrs["default"].decode()]
        group = entry[entry.attrs["default"].decode()]
        signal = group[group.attrs["signal"].decode()]
        axes = [name.decode() for name in group.attrs["axes"]]
        assert (entry.attrs["NX_class"], group.attrs["NX_class"]) == (b"NXentry", b"NXdata")
        assert len(axes) == signal.ndim
        assert axes[1:] == [".", "."]
        assert group[axes[0]].shape == signal.shape[:1]
        assert np.isfinite(group[axes[0]][:]).all()
        assert group[axes[0]].attrs["units"] == b"um"


def test_a_colour_scan_names_one_axis_for_each_of_its_dimensions(tmp_path: Path) -> None:
    start = start_of(tmp_path / "scan", COUNT, FrameFormat(32, 16, 8, "rgb"))
    create_scan(Path(start.path), start).close()
    with h5py.File(tmp_path / "scan/scan.partial.h5") as file:
        assert len(file["/entry/data"].attrs["axes"]) == file["/entry/data/data"].ndim == 4


def test_nothing_in_the_file_has_a_variable_length(scan: ScanFile) -> None:
    def is_fixed(thing: h5py.Group | h5py.Dataset) -> None:
        assert all(thing.attrs.get_id(name).dtype.kind in "fiuS" for name in thing.attrs)
        if isinstance(thing, h5py.Dataset):
            assert thing.chunks is None
            assert thing.dtype.kind in "fiuS"

    with h5py.File(scan.path) as file:
        is_fixed(file)
        file.visititems(lambda _, thing: is_fixed(thing))


def test_the_file_is_complete_and_reserved_before_the_first_frame(scan: ScanFile) -> None:
    size = scan.path.stat().st_size
    assert scan.reserved
    assert scan.path.stat().st_blocks * 512 >= COUNT * 48 * 64
    write(scan, start_of(scan.path.parent, COUNT), COUNT - 1)
    assert scan.path.stat().st_size == size


def test_creation_leaves_no_temporary_file(scan: ScanFile) -> None:
    assert [path.name for path in scan.path.parent.iterdir()] == ["scan.partial.h5"]


def test_a_leftover_of_a_creation_that_died_is_replaced(start: Start) -> None:
    folder = Path(start.path)
    folder.mkdir()
    creating_path(folder, start.scan_uid).write_bytes(b"torn")
    create_scan(folder, start).close()
    assert not list(folder.glob(f"{CREATING_PREFIX}*"))


@pytest.mark.parametrize("name", ["scan.h5", "scan.partial.h5"])
def test_a_folder_that_holds_a_scan_is_refused(start: Start, name: str) -> None:
    folder = Path(start.path)
    folder.mkdir()
    (folder / name).write_bytes(b"somebody's")
    with pytest.raises(ScanExistsError, match="holds a scan already"):
        create_scan(folder, start)
    assert (folder / name).read_bytes() == b"somebody's"


def test_a_full_disk_is_found_before_anything_is_made(start: Start) -> None:
    with file_size_limit(100_000), pytest.raises(DiskFullError, match=r"needed.*free.*storage\.data_dir"):
        create_scan(Path(start.path), start)
    assert not Path(start.path).exists()


def test_a_file_system_that_cannot_reserve_is_asked_for_its_free_space(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("acquire.writer.create_file.reserve", lambda *_: False)
    create_scan(Path(start.path), start).close()
    monkeypatch.setattr("acquire.writer.create_file.free_bytes", lambda _: 1000)
    with pytest.raises(DiskFullError):
        create_scan(Path(start.path).with_name("other"), start)


def test_a_data_dir_that_is_a_file_is_refused_with_a_way_out(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    start = start_of(tmp_path / "taken" / "scan", COUNT)
    with pytest.raises(DiskError, match=r"storage\.data_dir"):
        create_scan(Path(start.path), start)


@pytest.mark.parametrize("uid", ["", "../evil", "a/b", "x" * 120, "nul\0"])
def test_a_uid_that_is_no_file_name_is_refused(tmp_path: Path, uid: str) -> None:
    with pytest.raises(ScanFileError, match="is no scan uid"):
        create_scan(tmp_path / "scan", start_of(tmp_path / "scan", COUNT, scan_uid=uid))
    assert not (tmp_path / "scan").exists()


@pytest.mark.parametrize("path", ["relative/scan", "/tmp/nul\0"])
def test_a_folder_without_an_absolute_path_is_refused(path: str) -> None:
    with pytest.raises(ScanFileError, match="absolute path"):
        create_scan(Path(path), start_of(Path(path), COUNT))


# ---- frames ----


def test_a_committed_frame_is_seen_by_a_reader_that_was_open_before(scan: ScanFile, start: Start) -> None:
    with ScanReader(scan.path) as reader:
        assert reader.committed_through() == -1
        assert write(scan, start, 0) == "committed"
        assert reader.committed_through() == 0
        assert np.array_equal(reader.frame(0), pixels_of(0, COUNT, start.format))
        assert reader.field("trigger_id")[0] == 100
        assert reader.field("position_um")[0] == 0


def test_the_status_is_written_after_everything_else(
    scan: ScanFile, start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    offsets: list[int] = []
    real = os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda fd, data, offset: (offsets.append(offset), real(fd, data, offset))[1])
    write(scan, start, 2)
    assert offsets[0] == scan.layout.frame_offset(2)
    assert offsets[-1] == scan.layout.regions["status"].offset + 2


def test_the_same_frame_again_is_acknowledged_and_changes_nothing(scan: ScanFile, start: Start) -> None:
    write(scan, start, 1)
    assert write(scan, start, 1, attempt=1) == "same"
    with ScanReader(scan.path) as reader:
        assert reader.status()[1] == FrameStatus.GOOD


def test_another_frame_in_a_committed_place_is_refused(scan: ScanFile, start: Start) -> None:
    write(scan, start, 1)
    with pytest.raises(FrameRefusedError, match="frame 1 is committed with other pixels") as refused:
        write(scan, start, 1, seed=9)
    assert refused.value.reason == "immutable"
    with ScanReader(scan.path) as reader:
        assert np.array_equal(reader.frame(1), pixels_of(1, COUNT, start.format))


def test_a_frame_that_another_process_committed_meanwhile_is_not_overwritten(start: Start, scan: ScanFile) -> None:
    successor = ScanFile.open_existing(scan.path)
    write(successor, start, 3, seed=5)
    with pytest.raises(FrameRefusedError) as refused:
        write(scan, start, 3)
    assert refused.value.reason == "immutable"
    successor.close()


def test_a_scan_that_somebody_else_closed_meanwhile_takes_no_frame_and_no_other_end(
    start: Start, scan: ScanFile
) -> None:
    """A writer that was frozen wakes up after its scan was closed by hand."""
    write(scan, start, 0)
    successor = ScanFile.open_existing(scan.path)
    successor.seal(Outcome.ABORTED, "closed by hand")
    successor.close()
    with pytest.raises(FrameRefusedError, match="sealed the scan meanwhile"):
        write(scan, start, 1)
    with pytest.raises(DiskError, match="another process"):
        scan.seal(Outcome.STOPPED)
    report = verify(Path(start.path))
    assert report.ok and (report.outcome, report.committed) == ("aborted", 1)


def test_a_frame_of_a_later_attempt_is_marked_as_retaken(scan: ScanFile, start: Start) -> None:
    write(scan, start, 4, attempt=2)
    with ScanReader(scan.path) as reader:
        assert (reader.status()[4], reader.field("attempt")[4]) == (FrameStatus.RETAKEN, 2)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"crc32": 1}, "crc"),
        ({"shape": [64, 48]}, "shape"),
        ({"dtype": "<u2"}, "shape"),
        ({"pixel_format": "bayer_rggb"}, "shape"),
    ],
)
def test_a_frame_that_does_not_fit_is_refused_by_reason(
    scan: ScanFile, start: Start, changed: dict[str, object], reason: str
) -> None:
    with pytest.raises(FrameRefusedError) as refused:
        write(scan, start, 0, **changed)
    assert refused.value.reason == reason
    assert scan.committed_count == 0


def test_a_frame_beyond_the_plan_is_refused(scan: ScanFile, start: Start) -> None:
    with pytest.raises(FrameRefusedError, match="beyond the 6 frames") as refused:
        write(scan, start, COUNT)
    assert refused.value.reason == "protocol"


def test_pixels_that_are_cut_short_are_refused(scan: ScanFile, start: Start) -> None:
    pixels = pixels_of(0, COUNT, start.format)
    with pytest.raises(FrameRefusedError, match="bytes of pixels"):
        scan.write_frame(image_of(0, pixels, start), pixels.tobytes()[:-1])


def test_a_disk_that_is_full_in_mid_sweep_commits_nothing_and_can_go_on_later(scan: ScanFile, start: Start) -> None:
    write(scan, start, 0)
    with file_size_limit(scan.layout.frame_offset(2) + 10):
        write(scan, start, 1)
        with pytest.raises(DiskFullError):
            write(scan, start, 2)
    assert scan.committed_ranges() == [(0, 1)]
    assert write(scan, start, 2) == "committed"


def test_a_scan_file_that_was_deleted_takes_no_more_frames(scan: ScanFile, start: Start) -> None:
    scan.path.unlink()
    with pytest.raises(DiskError, match="No such file|deleted"):
        write(scan, start, 0)


def test_check_frames_stand_beside_the_sweep(scan: ScanFile, start: Start) -> None:
    dark = pixels_of(0, COUNT, start.format, seed=7)
    assert scan.write_frame(image_of(0, dark, start, role="dark"), dark) == "committed"
    assert scan.write_frame(image_of(0, dark, start, role="dark"), dark) == "same"
    with ScanReader(scan.path) as reader:
        found = reader.check_frame("dark")
        assert found is not None and np.array_equal(found, dark)
        assert reader.check_frame("ambient") is None
        assert not reader.status().any()


# ---- pressing onto the disk ----


def test_the_durable_count_is_that_of_the_committed_prefix(scan: ScanFile, start: Start) -> None:
    for frame_index in (0, 1, 3):
        write(scan, start, frame_index)
    assert scan.sync() == 2
    with ScanReader(scan.path) as reader:
        assert reader.scalar("durable_count") == 2


def test_a_sync_that_fails_does_not_count_and_is_made_good_by_the_next(
    scan: ScanFile, start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    fill(scan, start)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fdatasync", fails)
        with pytest.raises(DiskError, match="Input/output error"):
            scan.sync()
    assert scan.durable_count == 0
    written: list[int] = []
    real = os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda fd, data, offset: (written.append(offset), real(fd, data, offset))[1])
    assert scan.sync() == COUNT
    assert {scan.layout.frame_offset(frame_index) for frame_index in range(COUNT)} <= set(written)


def test_what_a_failed_sync_took_of_the_commit_records_is_put_back(
    scan: ScanFile, start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    fill(scan, start)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fdatasync", fails)
        with pytest.raises(DiskError):
            scan.sync()
    status = scan.layout.regions["status"]
    with scan.path.open("r+b") as file:
        file.seek(status.offset)
        file.write(bytes(COUNT))  # the kernel gave the page up and reads the disk again
    assert scan.sync() == COUNT
    with ScanReader(scan.path) as reader:
        assert reader.present().all()


# ---- coming back ----


def test_a_scan_that_was_begun_before_goes_on_where_it_was(scan: ScanFile, start: Start) -> None:
    write(scan, start, 0)
    write(scan, start, 2)
    again = ScanFile.open_existing(scan.path.parent)
    assert again.committed_ranges() == [(0, 0), (2, 2)]
    assert again.committed_crc32() == scan.committed_crc32()
    assert again.missing_ranges() == [(1, 1), (3, 5)]
    again.close()


def test_a_frame_that_a_power_cut_tore_is_found_when_the_scan_is_opened(scan: ScanFile, start: Start) -> None:
    write(scan, start, 0)
    scan.sync()
    write(scan, start, 1)
    with scan.path.open("r+b") as file:
        file.seek(scan.layout.frame_offset(1))
        file.write(b"torn")
    again = ScanFile.open_existing(scan.path.parent)
    assert again.committed_ranges() == [(0, 0)]
    with ScanReader(scan.path) as reader:
        assert reader.status()[1] == FrameStatus.DAMAGED
    assert write(again, start, 1, attempt=1) == "committed"
    again.close()


def test_a_truncated_file_is_refused(scan: ScanFile) -> None:
    with scan.path.open("r+b") as file:
        file.truncate(scan.path.stat().st_size // 2)
    with pytest.raises(ScanFileError, match="truncated"):
        ScanFile.open_existing(scan.path)


# ---- sealing ----


def test_a_complete_scan_is_sealed_under_its_last_name_with_its_digest(scan: ScanFile, start: Start) -> None:
    fill(scan, start)
    seal = scan.seal(Outcome.COMPLETE, "done")
    assert (seal.path.name, seal.committed, seal.missing) == ("scan.h5", COUNT, [])
    assert [path.name for path in seal.path.parent.iterdir()] == ["scan.h5"]
    with ScanReader(seal.path) as reader:
        assert (reader.outcome, reader.scalar("reason")) == ("complete", "done")
        assert (reader.scalar("digest"), reader.scalar("frames_committed")) == (seal.digest, COUNT)
        assert reader.scalar("durable_count") == COUNT


def test_what_was_measured_around_the_sweep_is_in_the_sealed_file(scan: ScanFile, start: Start) -> None:
    fill(scan, start)
    scan.seal(Outcome.COMPLETE, "", {"drift_px": 0.25, "steps_lost": 0.0, "brightness_change": float("nan")})
    with ScanReader(Path(start.path)) as reader:
        assert reader.measured == {"drift_px": 0.25, "steps_lost": 0.0}


def test_measurements_that_do_not_fit_are_left_out_whole_and_do_not_keep_a_scan_from_being_sealed(
    scan: ScanFile, start: Start
) -> None:
    fill(scan, start)
    assert scan.seal(Outcome.COMPLETE, "", {f"{k:0100d}": 1.0 for k in range(100)}).committed == COUNT
    with ScanReader(Path(start.path)) as reader:
        assert reader.measured == {}


def test_sealing_again_says_the_same(scan: ScanFile, start: Start) -> None:
    fill(scan, start)
    seal = scan.seal(Outcome.COMPLETE)
    assert scan.seal(Outcome.COMPLETE) == seal
    again = ScanFile.open_existing(seal.path.parent)
    assert again.seal(Outcome.COMPLETE) == seal
    again.close()


def test_a_scan_with_missing_frames_is_never_sealed_as_complete(scan: ScanFile, start: Start) -> None:
    write(scan, start, 0)
    with pytest.raises(ScanIncompleteError) as incomplete:
        scan.seal(Outcome.COMPLETE)
    assert incomplete.value.missing == [(1, 5)]
    assert scan.path.name == "scan.partial.h5"


def test_a_stopped_scan_is_sealed_with_what_it_has(scan: ScanFile, start: Start) -> None:
    write(scan, start, 0)
    seal = scan.seal(Outcome.STOPPED, "by the operator")
    assert (seal.committed, seal.missing) == (1, [(1, 5)])


def test_a_frame_whose_pixels_changed_is_found_at_sealing(scan: ScanFile, start: Start) -> None:
    fill(scan, start)
    with scan.path.open("r+b") as file:
        file.seek(scan.layout.frame_offset(3))
        file.write(b"flipped")
    with pytest.raises(ScanIncompleteError) as incomplete:
        scan.seal(Outcome.COMPLETE)
    assert incomplete.value.missing == [(3, 3)]


@pytest.mark.parametrize("outcome", [Outcome.RUNNING, Outcome.INTERRUPTED])
def test_an_unfinished_outcome_cannot_be_sealed(scan: ScanFile, outcome: Outcome) -> None:
    with pytest.raises(ScanFileError, match="stays partial"):
        scan.seal(outcome)


def test_a_sealed_scan_takes_no_new_frames_and_acknowledges_old_ones(scan: ScanFile, start: Start) -> None:
    write(scan, start, 0)
    scan.seal(Outcome.STOPPED)
    assert write(scan, start, 0) == "same"
    with pytest.raises(FrameRefusedError, match="sealed as stopped"):
        write(scan, start, 1)


def test_a_long_reason_is_cut_between_characters(scan: ScanFile) -> None:
    scan.seal(Outcome.FAILED, "ü" * 400)
    with ScanReader(scan.path) as reader:
        assert reader.scalar("reason") == "ü" * 256


def test_an_interrupted_scan_says_so_and_stays_partial(scan: ScanFile) -> None:
    scan.mark_outcome(Outcome.INTERRUPTED, "the daemon died")
    with ScanReader(scan.path) as reader:
        assert reader.outcome == "interrupted"
    with pytest.raises(ScanFileError, match="sealing"):
        scan.mark_outcome(Outcome.COMPLETE, "")


# ---- going on after a stop ----


def stopped(start: Start, frames: int = 3) -> Path:
    """A scan of :data:`COUNT` frames that was sealed as stopped; returns its folder."""
    with closing(create_scan(Path(start.path), start)) as made:
        for frame_index in range(frames):
            write(made, start, frame_index)
        made.seal(Outcome.STOPPED, "by the operator")
    return Path(start.path)


def test_a_stopped_scan_goes_on_and_equals_one_that_was_never_stopped(tmp_path: Path) -> None:
    start, whole = start_of(tmp_path / "stopped", COUNT), start_of(tmp_path / "whole", COUNT)
    with closing(ScanFile.reopen(stopped(start))) as scan:
        assert (scan.path.name, scan.sealed, scan.outcome, scan.committed_count) == (
            "scan.partial.h5",
            False,
            "running",
            3,
        )
        with pytest.raises(FrameRefusedError, match="other pixels"):
            write(scan, start, 1, seed=9)
        for frame_index in range(3, COUNT):
            assert write(scan, start, frame_index) == "committed"
        seal = scan.seal(Outcome.COMPLETE)
    with closing(create_scan(Path(whole.path), whole)) as other:
        fill(other, whole)
        assert seal.digest == other.seal(Outcome.COMPLETE).digest
    assert verify(Path(start.path)).complete and not (Path(start.path) / "scan.partial.h5").exists()


@pytest.mark.parametrize("outcome", [Outcome.COMPLETE, Outcome.ABORTED, Outcome.FAILED])
def test_a_scan_that_ended_otherwise_stays_sealed(start: Start, outcome: Outcome) -> None:
    with closing(create_scan(Path(start.path), start)) as scan:
        fill(scan, start)
        scan.seal(outcome)
    before = (Path(start.path) / "scan.h5").read_bytes()
    with pytest.raises(ScanFileError, match=f"sealed as {outcome}"):
        ScanFile.reopen(Path(start.path))
    assert (Path(start.path) / "scan.h5").read_bytes() == before


def test_copies_of_the_stopped_scan_no_longer_count(start: Start, caplog: pytest.LogCaptureFixture) -> None:
    folder = stopped(start)
    (folder / "copies.json").write_text("[]")
    ScanFile.reopen(folder).close()
    assert not (folder / "copies.json").exists() and "copy it again" in caplog.text


def test_a_stopped_scan_whose_space_was_given_back_reserves_it_again_or_stays_sealed(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = stopped(start)
    list(recover(folder, RecoverOptions(compact=True)))
    held = (folder / "scan.h5").stat().st_blocks

    def no_space(_path: Path) -> bool:
        raise OSError(errno.ENOSPC, "no space")

    with monkeypatch.context() as patch:
        patch.setattr(scan_file, "reserve_and_sync", no_space)
        with pytest.raises(DiskFullError, match="needed"):
            ScanFile.reopen(folder)
    assert verify(folder).ok and (folder / "scan.h5").exists()
    with closing(ScanFile.reopen(folder)) as scan:
        assert scan.reserved and scan.path.stat().st_blocks > held
