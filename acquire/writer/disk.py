"""System calls that make bytes durable (fallocate, fsync, rename), with errors that name path, action and cure."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from acquire.contract.errors import ScanFileError
from acquire.contract.units import format_bytes

_NO_SPACE: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
_NO_RESERVATION: Final = frozenset({errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL})
_RENAME_NOREPLACE: Final = 1
_PUNCH_HOLE_KEEP_SIZE: Final = 3
_AT_FDCWD: Final = -100
_WAY_OUT: Final = "set storage.data_dir in rig.toml to another folder"

_libc = ctypes.CDLL(None, use_errno=True)


class DiskError(ScanFileError):
    """The file system refused to create, write or sync."""

    nack_reason: Literal["no space", "io error"] = "io error"


class DiskFullError(DiskError):
    """No space is left for the scan (or its quota or size limit is reached)."""

    nack_reason = "no space"


def disk_error(error: OSError, path: Path, doing: str, needed_bytes: int = 0) -> DiskError:
    """``error`` as one line that names the path, what was being done, and the way out.

    ``needed_bytes`` stands beside the free space in the text of a full disk; 0 leaves it out.
    """
    if error.errno in _NO_SPACE:
        needed = f"{format_bytes(needed_bytes)} needed, " if needed_bytes else ""
        limit = "a size limit" if error.errno == errno.EFBIG else "a full disk"
        return DiskFullError(
            f"cannot {doing} {path}: {limit} ({needed}{free_in_words(path)} free); make room, or {_WAY_OUT}"
        )
    why = error.strerror or error
    return DiskError(f"cannot {doing} {path}: {why}; repair the folder or its permissions, or {_WAY_OUT}")


def free_bytes(path: Path) -> int | None:
    """Bytes that an ordinary user may still write at ``path`` (which need not exist yet); None if unknown."""
    for place in (path, *path.parents):
        try:
            return shutil.disk_usage(place).free
        except OSError:
            continue
    return None


def free_in_words(path: Path) -> str:
    """The free space where ``path`` is, for a message."""
    free = free_bytes(path)
    return "an unknown number of bytes" if free is None else format_bytes(free)


def reserve(fd: int, size_bytes: int) -> bool:
    """Reserve the space of the whole file with fallocate(2), never with glibc's emulation by writing.

    Returns:
        False where the file system cannot reserve: a full disk is then found only while writing.

    Raises:
        OSError: no space, or another failure of the disk.
    """
    return _fallocate(fd, 0, 0, size_bytes)


def punch(fd: int, offset: int, size_bytes: int) -> bool:
    """Punch a hole: return the whole blocks within a range to the file system; the range then reads as zeros.

    Returns:
        False where the file system cannot.

    Raises:
        OSError: the disk refused.
    """
    return _fallocate(fd, _PUNCH_HOLE_KEEP_SIZE, offset, size_bytes)


def _fallocate(fd: int, mode: int, offset: int, size_bytes: int) -> bool:
    # 64-bit offsets also on a 32-bit machine, where plain fallocate takes 32
    call = getattr(_libc, "fallocate64", _libc.fallocate)
    call.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_int64, ctypes.c_int64)
    while call(fd, mode, offset, size_bytes) != 0:
        number = ctypes.get_errno()
        if number in _NO_RESERVATION:
            return False
        if number != errno.EINTR:
            raise OSError(number, os.strerror(number))
    return True


def rename_new(source: Path, target: Path) -> None:
    """Atomic rename that never replaces an existing target (renameat2 with RENAME_NOREPLACE).

    Raises:
        FileExistsError: there is a target already.
        OSError: the disk refused.
    """
    call = getattr(_libc, "renameat2", None)
    if call is not None:
        if call(_AT_FDCWD, os.fsencode(source), _AT_FDCWD, os.fsencode(target), _RENAME_NOREPLACE) == 0:
            return
        number = ctypes.get_errno()
        if number not in _NO_RESERVATION:
            raise OSError(number, os.strerror(number), str(target))
    # kernel or file system lack the call; the writer's lock excludes other writers meanwhile
    if target.exists():
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target))
    source.rename(target)


@dataclass(frozen=True)
class FileSystem:
    """Kind of a file system, and whether a space reservation holds on it."""

    kind: str
    promise: str


_PROMISES: Final = {
    "ext4": "reserved blocks cannot run out; fdatasync reaches the disk",
    "xfs": "reserved blocks cannot run out; fdatasync reaches the disk",
    "btrfs": "reserved once; snapshots and compression can still run out of space",
    "tmpfs": "reserved in memory: survives no power cut",
    "overlay": "as the file system below the overlay",
    "vfat": "files up to 4 GB; rename is not safe in a power cut",
    "exfat": "no journal: a power cut can damage the folder",
}


def file_system_of(path: Path) -> FileSystem:
    """The file system that holds ``path``, from the kernel's table of mounts; ``unknown`` where it does not say."""
    place, kind, longest = path.resolve(), "unknown", -1
    for line in Path("/proc/self/mountinfo").read_text(encoding="utf-8", errors="replace").splitlines():
        mount, _, rest = line.partition(" - ")
        point = Path(mount.split()[4].replace("\\040", " "))
        # of several mounts on one point the last is visible
        if place.is_relative_to(point) and len(point.parts) >= longest:
            kind, longest = rest.split()[0], len(point.parts)
    return FileSystem(kind, _PROMISES.get(kind, "no promise is known for it"))
