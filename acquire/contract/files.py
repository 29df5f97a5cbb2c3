"""Small files: read as text whatever editor wrote them, and replaced in one step by a rename."""

from __future__ import annotations

import codecs
import os
import select
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Final

MAX_TEXT_BYTES: Final = 64 * 1024 * 1024
PIPE_S: Final = 5.0
"""Longest wait for somebody to write into a pipe that is given as a file."""
_TOO_LARGE: Final = "it is over {} bytes"
_UTF16: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text(path: Path, max_bytes: int = MAX_TEXT_BYTES) -> str:
    """The text of a file in UTF-8; a byte order mark, as Windows editors write it, is left out.

    Raises:
        OSError: the file is not there or cannot be read.
        ValueError: no file or pipe, larger than ``max_bytes``, or not UTF-8; the text says which.
    """
    return decode_text(read_bytes(path, max_bytes))


def read_bytes(path: Path, max_bytes: int) -> bytes:
    """The content of a small file; never waits for ever, nor reads a device.

    Raises:
        OSError: the file is not there or cannot be read.
        ValueError: no file or pipe, or larger than ``max_bytes``; the text says which.
    """
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # opening a pipe does not wait for its writer
    try:
        _check_kind(fd, max_bytes)
        os.set_blocking(fd, True)
        with os.fdopen(fd, "rb", closefd=False) as file:
            content = file.read(max_bytes + 1)
    finally:
        os.close(fd)
    if len(content) > max_bytes:
        raise ValueError(_TOO_LARGE.format(max_bytes))
    return content


def decode_text(content: bytes) -> str:
    """UTF-8 ``content`` without a byte order mark.

    Raises:
        ValueError: it is UTF-16, holds NUL bytes, or is not UTF-8; the text says which and what to do.
    """
    if content.startswith(_UTF16):
        raise ValueError("it is UTF-16 text: save it as UTF-8")
    if b"\0" in content:
        raise ValueError(f"it holds a NUL byte at byte {content.index(0)}: it is no text in UTF-8, or it is damaged")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ValueError(f"line {line} holds a byte that is not UTF-8: save it as UTF-8") from None


def reason(error: Exception) -> str:
    """Why a file could not be read, without its name (which the caller says)."""
    return (error.strerror if isinstance(error, OSError) else "") or str(error)


def _check_kind(fd: int, max_bytes: int) -> None:
    mode, size = os.fstat(fd).st_mode, os.fstat(fd).st_size
    if stat.S_ISDIR(mode):
        raise ValueError("it is a folder")
    if stat.S_ISFIFO(mode):
        if not select.select([fd], [], [], PIPE_S)[0]:
            raise ValueError(f"it is a pipe into which nothing was written for {PIPE_S:g} s")
    elif not stat.S_ISREG(mode):
        raise ValueError("it is no regular file")
    elif size > max_bytes:
        raise ValueError(_TOO_LARGE.format(max_bytes))


def replace_file(
    path: Path, content: bytes | Callable[[Path], object], *, durable: bool = False, mode: int | None = None
) -> None:
    """Write ``content`` beside ``path`` and rename it onto ``path``.

    Args:
        path: the file to create or to replace; its folder exists.
        content: the bytes, or a function that writes (or links) the temporary path it is given.
        durable: fsync the file before the rename and the folder after it, so that the new file survives a power cut.
            Leave it out for files that can be made again.
        mode: permissions; the file never has wider ones, not even under its temporary name. None: those of the umask.

    Raises:
        OSError: the disk refused; a file that was there is untouched, and nothing of the new one is left.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        if mode is not None:
            temporary.unlink(missing_ok=True)
            os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode))
            temporary.chmod(mode)  # the umask may have taken away what was asked for
        if isinstance(content, bytes):
            temporary.write_bytes(content)
        else:
            content(temporary)
        if durable:
            sync(temporary)
        temporary.replace(path)
        if durable:
            sync(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def sync(path: Path) -> None:
    """Fsync a file, or a folder, so that names made or changed in it survive a power cut."""
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def leftovers(folder: Path) -> list[Path]:
    """Temporary files of :func:`replace_file` whose process died before the rename."""
    return [path for path in folder.glob(".*.tmp") if not _writer_lives(path)]


def _writer_lives(temporary: Path) -> bool:
    pid = temporary.name.split(".")[-2]
    return pid.isdecimal() and Path("/proc", pid).exists()
