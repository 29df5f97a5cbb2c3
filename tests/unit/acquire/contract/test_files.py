"""Files replaced in one step: the old one or the new one, never half of it, and never readable by more people."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from acquire.contract import files
from acquire.contract.files import leftovers, read_text, replace_file

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


# ---- text that any editor may have written ----


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"\xef\xbb\xbf[stage]\r\n", "[stage]\r\n"),
        (b"", ""),
        (b"\xef\xbb\xbf", ""),
        ("f\u00fcr".encode(), "f\u00fcr"),
    ],
    ids=["byte order mark", "empty", "only a mark", "UTF-8"],
)
def test_utf8_is_read_with_and_without_a_byte_order_mark(target, content, text):
    target.write_bytes(content)
    assert read_text(target) == text


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("[stage]".encode("utf-16"), "UTF-16"),
        ("\ufeff[stage]".encode("utf-16-be"), "UTF-16"),
        ("[stage]".encode("utf-16-le"), "NUL"),
        (b"a\0b", "NUL byte at byte 1"),
        (b"name = 1\nf\xfcr = 2\n", "line 2 .* not UTF-8"),
        (b"x" * 101, "over 100 bytes"),
    ],
)
def test_what_is_no_utf8_text_is_told_from_the_rest(target, content, words):
    target.write_bytes(content)
    with pytest.raises(ValueError, match=words):
        read_text(target, max_bytes=100)


def test_a_folder_and_a_device_are_no_text(tmp_path):
    with pytest.raises(ValueError, match="folder"):
        read_text(tmp_path)
    with pytest.raises(ValueError, match="regular"):
        read_text(Path("/dev/zero"))


def test_a_pipe_is_read_and_one_without_a_writer_ends_by_itself(tmp_path, monkeypatch):
    read_end, write_end = os.pipe()
    os.write(write_end, b"\xef\xbb\xbf{}")
    os.close(write_end)
    assert read_text(Path(f"/dev/fd/{read_end}")) == "{}"
    os.close(read_end)
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.setattr(files, "PIPE_S", 0.05)
    with pytest.raises(ValueError, match="nothing was written"):
        read_text(tmp_path / "pipe")
