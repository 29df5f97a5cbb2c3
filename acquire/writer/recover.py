"""Recovers scans whose owner died: verifies them and marks them as interrupted, or seals them.

A scan whose `owner.lock` is held is never touched. Running it twice equals running it once. It may be killed at any
step: each step leaves a valid file, and the next run does the rest.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from acquire.contract.errors import AlreadyRunningError, ConfigError, ScanFileError
from acquire.contract.files import leftovers
from acquire.contract.frame_ranges import ranges_of
from acquire.contract.process.run_dir import FileLock
from acquire.contract.scan_data.dataset_names import (
    CREATING_PREFIX,
    NO_SCAN_NAMES,
    OWNER_LOCK_NAME,
    PARTIAL_NAME,
    SEALED_NAME,
    FrameStatus,
)
from acquire.contract.scan_data.reader import ScanReader
from acquire.contract.states import SEALED_OUTCOMES, Outcome, outcome_words
from acquire.contract.units import format_bytes

from .disk import punch
from .scan_file import ScanFile, ScanIncompleteError

State = Literal["in use", "no scan", "unreadable", "interrupted", "sealed"]
NOTHING_IN_IT = "no frame is in it: there is nothing to resume"


@dataclass(frozen=True)
class RecoverOptions:
    """What to do besides verifying."""

    seal: bool = False
    """Close interrupted scans for good."""
    compact: bool = False
    """Give back the space that is reserved for frames which a closed scan will never have."""
    begun_only: bool = False
    """Look only at scans that still call themselves running: those whose owner died since the last look."""


@dataclass(frozen=True)
class Recovered:
    """What was found in one folder, and what is in it now."""

    folder: Path
    state: State
    outcome: str = ""
    committed: int = 0
    expected: int = 0
    damaged: tuple[int, ...] = ()
    """Frames that this look found changed; they are marked and can be taken again."""
    freed_bytes: int = 0
    detail: str = ""

    def words(self) -> str:
        """One line for people."""
        if self.state in ("in use", "no scan", "unreadable"):
            return f"{self.folder.name}: {self.detail}"
        line = f"{self.folder.name}: {outcome_words(self.outcome, self.committed, self.expected)}"
        if self.damaged:
            line += f"; damaged and marked: frames {', '.join(map(str, self.damaged[:8]))}"
        if self.freed_bytes:
            line += f"; {format_bytes(self.freed_bytes)} given back"
        return line + (f" ({self.detail})" if self.detail else "")


def recover(
    where: Path, options: RecoverOptions = RecoverOptions(), *, stop: Callable[[], bool] = lambda: False
) -> Iterator[Recovered]:
    """Recover every scan in ``where`` (a data_dir, a scan's folder or its .h5), one after another.

    Args:
        where: a folder that does not exist holds no scans.
        options: what to do besides verifying.
        stop: asked between scans; True ends the look early.
    """
    for folder in scan_folders(where):
        if stop():
            return
        found = _recover_folder(folder, options)
        if found is not None:
            yield found


def scan_folders(where: Path) -> list[Path]:
    """The folders of scans at ``where``, itself included, by name."""
    where = where.parent if where.is_file() else where
    if _looks_like_scan(where):
        return [where]
    if not where.is_dir():
        return []
    return sorted(folder for folder in where.iterdir() if folder.is_dir() and _looks_like_scan(folder))


def _looks_like_scan(folder: Path) -> bool:
    if any((folder / name).exists() for name in (PARTIAL_NAME, SEALED_NAME, OWNER_LOCK_NAME)):
        return True
    return any(folder.glob(f"{CREATING_PREFIX}*"))


def _recover_folder(folder: Path, options: RecoverOptions) -> Recovered | None:
    """The result for one folder; None if there was nothing to do."""
    if options.begun_only and not _was_begun(folder):
        return None
    owner = _pid_in(folder / OWNER_LOCK_NAME)
    try:
        lock = FileLock(folder / OWNER_LOCK_NAME, "the sweep of this scan")
    except AlreadyRunningError:
        return Recovered(folder, "in use", detail=f"in use (pid {owner}): left alone")
    except ConfigError as error:
        return Recovered(folder, "unreadable", detail=str(error))
    try:
        return _look_after(folder, owner, options)
    except (ScanFileError, OSError) as error:
        return Recovered(folder, "unreadable", detail=f"left as it is: {error}")
    finally:
        lock.release()


def _was_begun(folder: Path) -> bool:
    """True if an owner may have died: its lock exists, and the scan is neither sealed nor marked."""
    if not (folder / OWNER_LOCK_NAME).exists() or (folder / SEALED_NAME).exists():
        return False
    if not (folder / PARTIAL_NAME).exists():
        return True
    try:
        with ScanReader(folder / PARTIAL_NAME) as reader:
            return reader.outcome != Outcome.INTERRUPTED
    except ScanFileError:
        return True


def _pid_in(lock: Path) -> str:
    try:
        return lock.read_text(encoding="ascii", errors="replace").strip()[:20] or "unknown"
    except OSError:
        return "unknown"


def _look_after(folder: Path, owner: str, options: RecoverOptions) -> Recovered:
    for leftover in (*folder.glob(f"{CREATING_PREFIX}*"), *leftovers(folder)):
        leftover.unlink(missing_ok=True)
    partial, sealed = folder / PARTIAL_NAME, folder / SEALED_NAME
    if not partial.exists() and not sealed.exists():
        return _without_scan(folder)
    path = sealed if sealed.exists() else partial
    with closing(ScanFile(path, sealed_path=sealed)) as scan:
        return _sealed_scan(scan, folder, options) if scan.sealed else _partial_scan(scan, folder, owner, options)


def _without_scan(folder: Path) -> Recovered:
    """The owner died before the scan file was created: the folder holds no data."""
    strangers = {path.name for path in folder.iterdir()} - NO_SCAN_NAMES
    if strangers:
        return Recovered(folder, "no scan", detail="holds no scan file; what else is in it was left alone")
    shutil.rmtree(folder)
    return Recovered(folder, "no scan", detail="held no scan file: removed")


def _sealed_scan(scan: ScanFile, folder: Path, options: RecoverOptions) -> Recovered:
    freed = _compact(scan.path) if options.compact else 0
    return Recovered(folder, "sealed", scan.outcome, scan.committed_count, scan.count, freed_bytes=freed)


def _partial_scan(scan: ScanFile, folder: Path, owner: str, options: RecoverOptions) -> Recovered:
    # records: a power cut affects only frames that were not durable; pixels: check all of them
    damaged = tuple(sorted([*scan.check_records(scan.durable_count), *scan.check_frames()]))
    ended_as = scan.outcome
    reason = ""
    if ended_as == Outcome.RUNNING:
        reason = f"F25 the process that owned the sweep (pid {owner}) ended without a word"
        scan.mark_outcome(Outcome.INTERRUPTED, reason)
    scan.sync()
    if ended_as in SEALED_OUTCOMES:
        reason = _seal_again(scan, Outcome(ended_as))
    elif not scan.committed_count and not damaged:
        reason = NOTHING_IN_IT
        scan.seal(Outcome.ABORTED, reason)
    elif options.seal:
        complete = not scan.missing_ranges()
        reason = "closed by recover after an interruption" + ("; the checks after the sweep were not made" * complete)
        scan.seal(Outcome.COMPLETE if complete else Outcome.ABORTED, reason)
    freed = _compact(scan.path) if scan.sealed and (options.compact or reason == NOTHING_IN_IT) else 0
    state: State = "sealed" if scan.sealed else "interrupted"
    return Recovered(folder, state, scan.outcome, scan.committed_count, scan.count, damaged, freed, reason)


def _seal_again(scan: ScanFile, outcome: Outcome) -> str:
    """The writer died between writing the outcome and renaming the file: finish the sealing."""
    with ScanReader(scan.path) as reader:
        why = str(reader.scalar("reason"))
    try:
        scan.seal(outcome, why)
    except ScanIncompleteError:
        reason = f"F25 the writer died while it sealed the scan as {outcome}, and frames were damaged"
        scan.mark_outcome(Outcome.INTERRUPTED, reason)
        return reason
    return "the writer had died while it sealed this scan"


def _compact(path: Path) -> int:
    """Punch out the pixels of frames that were never taken; a hole reads as zeros, the layout stays as it is.

    Returns:
        bytes that were freed; 0 if the file system cannot punch holes.
    """
    with ScanReader(path) as reader:
        missing = ranges_of(np.flatnonzero(reader.status() == FrameStatus.MISSING).tolist())
        start, size = reader.layout.frame_offset(0), reader.layout.frame_nbytes
    fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    try:
        before = os.fstat(fd).st_blocks
        for first, last in missing:
            if not punch(fd, start + first * size, (last - first + 1) * size):
                return 0
        os.fsync(fd)
        return max(0, before - os.fstat(fd).st_blocks) * 512
    finally:
        os.close(fd)
