"""Copies a scan to another disk and verifies the copy: each file is hashed when read, and again on the other disk."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from acquire.contract.config.load import home_resolved
from acquire.contract.errors import ScanFileError
from acquire.contract.files import read_text, reason, replace_file, sync
from acquire.contract.scan_data.dataset_names import CHECKSUMS_NAME, COPIES_NAME, OWNER_LOCK_NAME
from acquire.contract.units import format_bytes

CHUNK_BYTES = 4 * 1024 * 1024
MAX_FILE_BYTES = 1024 * 1024
Progress = Callable[[int, int], None]
"""Called with bytes done and bytes in total; every byte counts twice, for copying and for verifying."""


class Copied(msgspec.Struct, frozen=True):
    """A verified copy."""

    to: str
    """Absolute path of the copy's folder."""
    at_utc: str
    nbytes: int
    files: int

    def words(self) -> str:
        """One line."""
        return f"copied to {self.to} on {self.at_utc[:10]}, {self.files} files verified by checksum"


def copies_of(folder: Path) -> tuple[Copied, ...]:
    """The verified copies of the scan in ``folder``, from copies.json.

    Raises:
        ScanFileError: copies.json exists but cannot be read.
    """
    path = folder / COPIES_NAME
    try:
        return msgspec.json.decode(read_text(path, MAX_FILE_BYTES), type=tuple[Copied, ...])
    except FileNotFoundError:
        return ()
    except (OSError, ValueError, RecursionError) as error:
        raise ScanFileError(
            f"{path} cannot be read: {reason(error)}; remove it, copies are not changed by that"
        ) from None


def copy_scan(folder: Path, dest: Path, progress: Progress = lambda _done, _total: None) -> Copied:
    """Copy the scan's folder into the folder ``dest``, verify it there, and list it in the scan's copies.json.

    The caller holds the scan's lock.

    Raises:
        ScanFileError: the target exists or lies within the scan, there is no space, a file arrived damaged, or a disk
            fails. No part of the copy is left (nor after Ctrl-C), and the scan is unchanged.
    """
    files = _files_of(folder)
    total = sum(path.stat().st_size for path in files)
    target = _target(folder, dest, total)
    with _making(target) as making:
        done = 0

        def count(nbytes: int) -> None:
            nonlocal done
            done += nbytes
            progress(done, 2 * total)

        sums = {path.name: _copied(path, making / path.name, count) for path in files}
        for name, wanted in sums.items():
            if _digest(making / name, count) != wanted:
                raise ScanFileError(f"{name} arrived damaged on {dest}: nothing was kept there; check that disk")
        text = "".join(f"{digest}  {name}\n" for name, digest in sorted(sums.items()))
        (making / CHECKSUMS_NAME).write_text(text, encoding="utf-8")
        sync(making / CHECKSUMS_NAME)
        sync(making)
        making.rename(target)
    sync(target.parent)
    made = Copied(str(target), datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"), total, len(files))
    _mark(folder, made)
    return made


def _files_of(folder: Path) -> list[Path]:
    found = []
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or path.name in (OWNER_LOCK_NAME, COPIES_NAME, CHECKSUMS_NAME):
            continue
        if path.is_symlink() or not path.is_file():
            raise ScanFileError(f"{folder} holds {path.name}, which is no file of a scan: copy it by hand")
        found.append(path)
    return found


def _target(folder: Path, dest: Path, total: int) -> Path:
    dest = home_resolved(str(dest), "DEST").resolve()
    if not dest.is_dir():
        raise ScanFileError(f"{dest} is not a folder: make it, or mount the disk")
    if dest == folder or folder in dest.parents:
        raise ScanFileError(f"{dest} lies within the scan itself: name another folder")
    target = dest / folder.name
    if target.exists():
        raise ScanFileError(f"{target} is there already and was left alone: name another folder")
    free = shutil.disk_usage(dest).free
    if free < total:
        raise ScanFileError(f"{dest} has {format_bytes(free)} free, the scan needs {format_bytes(total)}: make room")
    return target


@contextmanager
def _making(target: Path) -> Iterator[Path]:
    """A temporary folder next to ``target``; it is removed unless it was renamed inside the block."""
    making = target.with_name(f".copying-{target.name}-{os.getpid()}")
    try:
        making.mkdir()
        yield making
    except OSError as error:
        raise ScanFileError(
            f"the copy to {target.parent} failed: {error.strerror or error}; nothing of it is left, the scan is whole"
        ) from None
    finally:
        shutil.rmtree(making, ignore_errors=True)


def _copied(source: Path, target: Path, count: Callable[[int], None]) -> str:
    """Copy a file and fsync it; returns the sha256 (hex) of what was read."""
    digest = hashlib.sha256()
    with source.open("rb") as reading, target.open("xb") as writing:
        while chunk := reading.read(CHUNK_BYTES):
            digest.update(chunk)
            writing.write(chunk)
            count(len(chunk))
        writing.flush()
        os.fsync(writing.fileno())
    shutil.copystat(source, target)
    return digest.hexdigest()


def _digest(path: Path, count: Callable[[int], None]) -> str:
    """sha256 (hex) of a file as read from the disk: its cached pages are dropped first."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        while chunk := file.read(CHUNK_BYTES):
            digest.update(chunk)
            count(len(chunk))
    return digest.hexdigest()


def _mark(folder: Path, made: Copied) -> None:
    """Add the copy to the scan's copies.json."""
    path = folder / COPIES_NAME
    text = msgspec.json.format(msgspec.json.encode((*copies_of(folder), made)), indent=1) + b"\n"
    try:
        replace_file(path, text, durable=True)
    except OSError as error:
        raise ScanFileError(f"the copy in {made.to} is whole, but {path} cannot be written: {error.strerror}") from None
