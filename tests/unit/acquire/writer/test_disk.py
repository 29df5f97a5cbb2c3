"""System calls on the disk, and what people read when one fails."""

from __future__ import annotations

import errno
import os
import select
import threading
from pathlib import Path

import pytest

from acquire.writer.disk import (
    DiskError,
    DiskFullError,
    disk_error,
    file_system_of,
    free_bytes,
    rename_new,
    reserve,
)
from acquire.writer.disk_thread import DiskThread
from acquire.writer.frame_store import write_at


def test_a_reserved_file_owns_its_blocks(tmp_path: Path) -> None:
    with (tmp_path / "file").open("w+b") as file:
        assert reserve(file.fileno(), 1_000_000)
        status = os.fstat(file.fileno())
        assert (status.st_size, status.st_blocks * 512 >= 1_000_000) == (1_000_000, True)


def test_a_reservation_that_is_too_large_is_an_error_and_not_a_false(tmp_path: Path) -> None:
    with (tmp_path / "file").open("w+b") as file, pytest.raises(OSError) as refused:
        reserve(file.fileno(), 1 << 60)
    assert refused.value.errno in (errno.ENOSPC, errno.EFBIG)


def test_a_rename_never_replaces_what_is_there(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("a")
    (tmp_path / "b").write_text("b")
    with pytest.raises(FileExistsError):
        rename_new(tmp_path / "a", tmp_path / "b")
    assert (tmp_path / "b").read_text() == "b"
    rename_new(tmp_path / "a", tmp_path / "c")
    assert (tmp_path / "c").read_text() == "a"


def test_bytes_that_the_kernel_takes_in_pieces_are_all_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda fd, data, offset: real(fd, data[:3], offset))
    with (tmp_path / "file").open("w+b") as file:
        write_at(file.fileno(), b"0123456789", 2)
    assert (tmp_path / "file").read_bytes() == b"\0\x000123456789"


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_a_full_disk_is_named_with_needed_and_free_space_and_a_way_out(tmp_path: Path, number: int) -> None:
    error = disk_error(OSError(number, os.strerror(number)), tmp_path, "write", 5_000_000)
    assert isinstance(error, DiskFullError)
    assert error.nack_reason == "no space"
    assert all(part in str(error) for part in ("5.0 MB needed", "free", "storage.data_dir"))
    assert "\n" not in str(error)


def test_any_other_failure_is_an_io_error(tmp_path: Path) -> None:
    error = disk_error(OSError(errno.EIO, os.strerror(errno.EIO)), tmp_path, "sync")
    assert type(error) is DiskError
    assert error.nack_reason == "io error"


def test_free_space_is_that_of_the_nearest_folder_that_exists(tmp_path: Path) -> None:
    assert free_bytes(tmp_path / "not" / "yet") is not None


def test_the_file_system_is_called_by_its_name() -> None:
    assert file_system_of(Path("/proc")).kind == "proc"


def test_a_job_of_the_disk_thread_answers_on_the_thread_that_collects() -> None:
    disk, answers = DiskThread(), []
    disk.submit(lambda: 42, lambda done: answers.append((done.result(), threading.current_thread())))
    assert disk.wait(5)
    assert answers == [(42, threading.current_thread())]
    assert not disk.busy
    disk.close()


def test_a_job_that_was_waited_for_does_not_wake_the_poller_for_ever() -> None:
    disk = DiskThread()
    disk.submit(lambda: None, lambda done: done.result())
    assert disk.wait(5)
    # the wake-up is written by the disk's thread, perhaps after the wait has returned
    assert select.select([disk.fileno()], [], [], 5)[0]
    disk.collect()
    assert not select.select([disk.fileno()], [], [], 0)[0]
    disk.close()


def test_a_job_that_does_not_end_in_time_goes_on() -> None:
    disk, go, answers = DiskThread(), threading.Event(), []
    disk.submit(lambda: go.wait(5), lambda done: answers.append(done.result()))
    disk.collect()
    assert not disk.wait(0.01)
    assert disk.busy
    go.set()
    assert disk.wait(5)
    assert answers == [True]
    disk.close()


def test_an_error_of_a_job_reaches_the_one_who_asked() -> None:
    def fails() -> None:
        raise OSError(errno.EIO, "disk")

    disk, errors = DiskThread(), []
    disk.submit(fails, lambda done: errors.append(done.exception()))
    assert disk.wait(5)
    assert isinstance(errors[0], OSError)
    disk.close()
