"""Replace a file in one step: written under a temporary name, then renamed. A reader never sees half a file."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path


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
