"""Writes scan files (the only module that does): the file is valid at any moment, a committed frame never changes.

Order of writes per frame: pixels, record, status (the commit record). Order of a sync: fdatasync, ``durable_count``,
fdatasync. See docs/design.md, section 6.
"""

from __future__ import annotations

import errno
import logging
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.files import sync
from acquire.contract.messaging.messages import Image, Start
from acquire.contract.scan_data.checksums import frame_crc32, scan_digest
from acquire.contract.scan_data.dataset_names import (
    CHECK_ROLES,
    COPIES_NAME,
    PARTIAL_NAME,
    SEALED_NAME,
    FrameStatus,
    find_scan_file,
)
from acquire.contract.scan_data.reader import ScanReader
from acquire.contract.states import SEALED_OUTCOMES, Outcome

from .create_file import ScanRecipe, create_file, reserve_and_sync
from .disk import disk_error, rename_new
from .frame_store import USABLE, FrameRefusedError, ScanStore, write_at

logger = logging.getLogger(__name__)
Pixels = bytes | memoryview | NDArray[Any]


class ScanExistsError(ScanFileError):
    """The folder holds another scan."""


class ScanIncompleteError(ScanFileError):
    """A scan cannot be sealed as complete because frames are missing or damaged; it stays partial."""

    def __init__(self, path: Path, missing: list[tuple[int, int]]) -> None:
        super().__init__(f"{path} is not complete: frames {missing[:8]} are missing or damaged; take them again")
        self.missing = missing


@dataclass(frozen=True)
class Seal:
    """What was sealed, as it can be read back from the file."""

    path: Path
    outcome: Outcome
    committed: int
    missing: list[tuple[int, int]]
    digest: str


def create_scan(folder: Path, start: Start) -> ScanFile:
    """Create ``folder`` and the whole scan file in it as ``scan.partial.h5``, synced to disk.

    Raises:
        ScanExistsError: the folder holds a scan.
        DiskFullError: the space cannot be reserved; needed and free bytes are in the text.
        DiskError: the folder cannot be made or written.
    """
    if not folder.is_absolute() or "\0" in str(folder):
        raise ScanFileError(f"the folder of a scan is named by its absolute path, not {str(folder)[:80]!r}")
    try:
        made = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise disk_error(error, folder, "create the folder") from None
    try:
        return _create_in(folder, ScanRecipe.from_start(start))
    except ScanFileError:
        if made:
            with suppress(OSError):
                folder.rmdir()
        raise


def _create_in(folder: Path, recipe: ScanRecipe) -> ScanFile:
    for name in (SEALED_NAME, PARTIAL_NAME):
        if (folder / name).exists():
            raise ScanExistsError(f"{folder} holds a scan already ({name}): choose another name")
    creating, reserved = create_file(folder, recipe)
    partial = folder / PARTIAL_NAME
    try:
        rename_new(creating, partial)
        sync(folder)
        # the folder itself may be new: its name must survive a power cut as well
        sync(folder.parent)
    except OSError as error:
        creating.unlink(missing_ok=True)
        if error.errno == errno.EEXIST:
            raise ScanExistsError(f"{folder} holds a scan already: choose another name") from None
        raise disk_error(error, partial, "create") from None
    return ScanFile(partial, sealed_path=folder / SEALED_NAME, reserved=reserved)


class ScanFile(ScanStore):
    """A scan that is being written. One thread writes frames; :meth:`sync` may run beside it in another.

    Each frame is written as pixels, record, status: a reader that sees the status finds the frame.
    """

    def __init__(self, path: Path, *, sealed_path: Path, reserved: bool = True, replace: bool = False) -> None:
        """Open what ``create_file`` made; ``replace`` lets sealing replace what is at ``sealed_path``."""
        self.sealed = path == sealed_path
        super().__init__(path, writable=not self.sealed)
        self.reserved = reserved
        self._sealed_path = sealed_path
        self._replace = replace
        self._rewrite_from: int | None = None

    @classmethod
    def open_existing(cls, scan: Path) -> ScanFile:
        """Open a scan that was begun before. Frames that a power cut may have torn are checked first.

        Raises:
            ScanFileError: no scan, damaged, or truncated.
            DiskError: it cannot be opened for writing.
        """
        path = find_scan_file(scan)
        partial = path.name == PARTIAL_NAME
        opened = cls(path, sealed_path=path.with_name(SEALED_NAME) if partial else path)
        if partial:
            first = opened.durable_count
            opened.check_frames(first)
            opened.check_records(first)
        return opened

    @classmethod
    def reopen(cls, folder: Path) -> ScanFile:
        """Make a scan that was sealed as stopped partial again, so that the sweep can go on.

        The rename comes before the outcome: after a crash between them recovery seals it as it was. Copies are of the
        scan as it was, so they no longer count: the list of them is removed.

        Raises:
            ScanFileError: it was sealed with another outcome.
            DiskError: no space for the rest of the frames, or another failure of the disk; it stays sealed.
        """
        sealed, partial = folder / SEALED_NAME, folder / PARTIAL_NAME
        with ScanReader(sealed) as reader:
            if reader.outcome != Outcome.STOPPED:
                raise ScanFileError(f"{sealed} is sealed as {reader.outcome}: only a stopped scan can go on")
            nbytes = reader.layout.frame_nbytes * (reader.layout.count - int(reader.present().sum()))
        try:
            reserved = reserve_and_sync(sealed)
            if (folder / COPIES_NAME).exists():
                (folder / COPIES_NAME).unlink()
                logger.warning("copies of %s are of the scan as it was stopped: copy it again when it is done", folder)
            rename_new(sealed, partial)
            sync(folder)
        except OSError as error:
            raise disk_error(error, sealed, "go on with", nbytes) from None
        opened = cls.open_existing(folder)
        opened.reserved = reserved
        opened.mark_outcome(Outcome.RUNNING, "")
        return opened

    def write_frame(self, image: Image, pixels: Pixels) -> Literal["committed", "same"]:
        """Write a frame (of the sweep, or one of the check frames) so that it survives the death of any process.

        Args:
            image: its header.
            pixels: its bytes as stored, C-contiguous, in the scan's format.

        Returns:
            ``same`` if this very frame is there already.

        Raises:
            FrameRefusedError: wrong shape or checksum, or another frame was committed in its place.
            DiskError: the disk refused; the frame is not committed and can be sent again.
        """
        raw = (pixels.data if isinstance(pixels, np.ndarray) else memoryview(pixels)).cast("B")
        self._check(image, raw)
        sweep = image.role == "sweep"
        prefix, index = ("", image.frame_index) if sweep else ("checks/", CHECK_ROLES.index(image.role))
        with self._disk("write"):
            if os.fstat(self._fd).st_nlink == 0:
                raise OSError(errno.ENOENT, "the scan file was deleted")
            # ask the file, not memory: another writer may have written while this process was frozen
            again = image.role == "overlap" and not self.sealed
            if self._get(f"{prefix}status", index) in USABLE and not again:
                return self._compare(image, prefix, index)
            if self.sealed:
                raise FrameRefusedError("immutable", f"{_name(image)}: the scan is sealed as {self.outcome}")
            if self._get_text("outcome") in SEALED_OUTCOMES:
                raise FrameRefusedError("immutable", f"{_name(image)}: another process has sealed the scan meanwhile")
            if again:
                # each resume takes the overlap frame anew: if a crash tears it, it must not count as valid
                self._put(f"{prefix}status", index, FrameStatus.MISSING)
            self._put_pixels(f"{prefix}data", index, raw)
            if sweep:
                self._put_record(image)
            else:
                self._put("checks/crc32", index, image.crc32)
            self._put(f"{prefix}status", index, FrameStatus.RETAKEN if image.attempt else FrameStatus.GOOD)
        if sweep:
            self._note(image)
        return "committed"

    def _check(self, image: Image, raw: memoryview) -> None:
        wanted = self.layout.format
        if image.frame_index >= self.count:
            raise FrameRefusedError("protocol", f"{_name(image)} is beyond the {self.count} frames of the plan")
        if (tuple(image.shape), image.dtype, image.pixel_format) != (wanted.shape, wanted.dtype, wanted.pixel_format):
            raise FrameRefusedError(
                "shape",
                f"{_name(image)} is {image.dtype} {image.shape} {image.pixel_format}, "
                f"the scan {wanted.dtype} {list(wanted.shape)} {wanted.pixel_format}",
            )
        if raw.nbytes != wanted.nbytes:
            raise FrameRefusedError("shape", f"{_name(image)} has {raw.nbytes} bytes of pixels, not {wanted.nbytes}")
        if frame_crc32(raw) != image.crc32:
            raise FrameRefusedError("crc", f"{_name(image)}: its checksum does not fit its pixels")

    def _compare(self, image: Image, prefix: str, index: int) -> Literal["same"]:
        if self._get(f"{prefix}crc32", index) != image.crc32:
            raise FrameRefusedError("immutable", f"{_name(image)} is committed with other pixels already")
        if image.role == "sweep":
            self._note(image)
        return "same"

    def _note(self, image: Image) -> None:
        self._crc32[image.frame_index] = image.crc32
        self._status[image.frame_index] = self._get("status", image.frame_index)

    def sync(self) -> int:
        """fdatasync the committed frames, write their number as ``durable_count``, and fdatasync that.

        Returns:
            durable_count: frames 0..durable_count-1 survive a power cut.

        Raises:
            DiskError: the disk refused; durable_count is unchanged.
        """
        durable = self.prefix
        with self._disk("sync"):
            if self._rewrite_from is not None:
                self._write_again(self._rewrite_from)
            try:
                os.fdatasync(self._fd)
            except OSError:
                # the kernel may have dropped the pages, and would call the next sync a success
                self._rewrite_from = self.durable_count
                raise
            self._rewrite_from = None
            if durable > self.durable_count:
                self._put("durable_count", 0, durable)
                os.fdatasync(self._fd)
                self.durable_count = durable
        return self.durable_count

    def _write_again(self, first: int) -> None:
        """Write again what a failed sync may have lost. Committed frames never change, so this undoes nothing."""
        self.check_frames(first)
        self.check_records(first)
        for frame_index in np.flatnonzero(self._usable()[first:]) + first:
            self._put_again(int(frame_index))

    def mark_outcome(self, outcome: Outcome, reason: str) -> None:
        """Record in a partial scan why it is partial (or that it is running again).

        Raises:
            ScanFileError: the scan is sealed, or only sealing can give this outcome.
        """
        if self.sealed or outcome in SEALED_OUTCOMES:
            raise ScanFileError(f"{self.path} cannot be marked as {outcome}: that is what sealing is for")
        self._put_outcome(outcome, reason)

    def seal(self, outcome: Outcome, reason: str = "", measured: Mapping[str, float] | None = None) -> Seal:
        """Verify every frame, write outcome and digest, sync, and rename the file to ``scan.h5``.

        ``measured``: results of the checks around the sweep, by their names in the ``end`` message.

        Sealing again with the same outcome does nothing.

        Raises:
            ScanIncompleteError: it is to be ``complete`` and is not; it stays partial.
            ScanFileError: ``outcome`` cannot be sealed, or the scan is sealed with another one.
            DiskError: the disk refused; the scan stays partial and can be sealed again.
        """
        if outcome not in SEALED_OUTCOMES:
            raise ScanFileError(f"a scan that is {outcome} stays partial")
        if self.sealed:
            return self._sealed_before(outcome)
        self._refuse_if_replaced()
        self.check_frames()
        missing = self.missing_ranges()
        if outcome == Outcome.COMPLETE and missing:
            raise ScanIncompleteError(self.path, missing)
        seal = Seal(self._sealed_path, outcome, self.committed_count, missing, self._put_digest())
        self._put_measured(measured or {})
        self._put_outcome(outcome, reason)
        self.sync()
        self._rename()
        self._reread(seal)
        return seal

    def _refuse_if_replaced(self) -> None:
        """A file that was moved or replaced belongs to another process now: do not seal it."""
        with self._disk("seal"):
            if not self.path.exists() or not os.path.samestat(self.path.stat(), os.fstat(self._fd)):
                raise OSError(errno.ENOENT, "it was moved, deleted, or sealed by another process meanwhile")

    def _sealed_before(self, outcome: Outcome) -> Seal:
        if self.outcome != outcome:
            raise ScanFileError(f"{self.path} is sealed as {self.outcome} already, not as {outcome}")
        digest = scan_digest(self._crc32)
        return Seal(self.path, outcome, self.committed_count, self.missing_ranges(), digest)

    def _put_digest(self) -> str:
        # a record that was written without its commit must not count
        self._crc32[~self._usable()] = 0
        digest = scan_digest(self._crc32)
        with self._disk("seal"):
            write_at(self._fd, self._crc32.astype("<u4").tobytes(), self.layout.regions["crc32"].offset)
            self._put("frames_committed", 0, self.committed_count)
            self._put_text("digest", digest, len(digest))
        return digest

    def _rename(self) -> None:
        with self._disk("seal"):
            os.fsync(self._fd)
            if self._replace:
                self.path.replace(self._sealed_path)
            else:
                rename_new(self.path, self._sealed_path)
            self.path, self.sealed = self._sealed_path, True
            sync(self.path.parent)

    def _reread(self, seal: Seal) -> None:
        with ScanReader(seal.path) as reader:
            found = (reader.outcome, reader.scalar("digest"), reader.scalar("frames_committed"))
        if found != (seal.outcome, seal.digest, seal.committed):
            raise ScanFileError(f"{seal.path} reads back as {found}: look at the disk before the next scan")


def _name(image: Image) -> str:
    return f"frame {image.frame_index}" if image.role == "sweep" else f"the {image.role} frame"
