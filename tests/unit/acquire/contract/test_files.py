"""Files replaced in one step: the old one or the new one, never half of it, and never readable by more people."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from acquire.contract.files import leftovers, replace_file

NO_PID = 2**22 + 1
"""Above the kernel's highest process number."""


@pytest.fixture
def target(tmp_path: Path) -> Path:
    path = tmp_path / "file.json"
    path.write_bytes(b"old")
    return path


def test_the_new_file_takes_the_place_of_the_old_one_and_nothing_else_is_left(target):
    replace_file(target, b"new")
    assert target.read_bytes() == b"new" and list(target.parent.iterdir()) == [target]


def test_a_writer_that_fails_half_way_leaves_the_old_file(target):
    def write(temporary: Path) -> None:
        temporary.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        replace_file(target, write)
    assert target.read_bytes() == b"old" and list(target.parent.iterdir()) == [target]


def test_the_temporary_file_is_never_open_to_more_people_than_the_file_shall_be(target):
    modes = []

    def write(temporary: Path) -> None:
        modes.append(stat.S_IMODE(temporary.stat().st_mode))
        temporary.write_bytes(b"secret")

    replace_file(target, write, mode=0o600)
    assert [*modes, stat.S_IMODE(target.stat().st_mode)] == [0o600, 0o600]


def test_a_symbolic_link_is_replaced_itself_and_not_what_it_points_to(target):
    link = target.with_name("link")
    link.symlink_to(target)
    replace_file(link, lambda temporary: temporary.symlink_to("elsewhere"))
    assert str(link.readlink()) == "elsewhere" and target.read_bytes() == b"old"


@pytest.mark.parametrize(("durable", "expected"), [(True, ["file", "rename", "folder"]), (False, ["rename"])])
def test_a_durable_file_is_on_the_disk_before_it_gets_its_name_and_the_name_after(
    target, durable, expected, monkeypatch
):
    steps, fsync, replace = [], os.fsync, Path.replace

    def recorded_fsync(fd: int) -> None:
        steps.append("folder" if stat.S_ISDIR(os.fstat(fd).st_mode) else "file")
        fsync(fd)

    def recorded_replace(path: Path, other: Path) -> Path:
        steps.append("rename")
        return replace(path, other)

    monkeypatch.setattr(os, "fsync", recorded_fsync)
    monkeypatch.setattr(Path, "replace", recorded_replace)
    replace_file(target, b"new", durable=durable)
    assert steps == expected


def test_what_a_dead_process_left_is_told_from_what_a_living_one_writes(target):
    dead = target.with_name(f".maps.h5.{NO_PID}.tmp")
    for path in (dead, target.with_name(f".maps.h5.{os.getpid()}.tmp")):
        path.write_bytes(b"half")
    assert leftovers(target.parent) == [dead]
