"""Byte access to an open scan file: regions at their offsets, commit records, checksums. No HDF5 after opening."""

from __future__ import annotations

import json
import math
import os
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.frame_ranges import ranges_of
from acquire.contract.messaging.messages import Image
from acquire.contract.scan_data.checksums import frame_crc32
from acquire.contract.scan_data.dataset_names import (
    FRAME_FIELDS,
    MEASURED,
    MEASURED_BYTES,
    OUTCOME_BYTES,
    REASON_BYTES,
    FrameStatus,
)
from acquire.contract.scan_data.file_layout import ScanLayout, read_layout
from acquire.contract.scan_data.reader import ScanReader
from acquire.contract.states import Outcome

from .disk import disk_error

Refusal = Literal["shape", "crc", "immutable", "protocol"]
USABLE: Final = (FrameStatus.GOOD, FrameStatus.RETAKEN)
_PACK: Final = {
    dtype: struct.Struct(code)
    for dtype, code in {"<f8": "<d", "<i8": "<q", "|u1": "<B", "<u4": "<I", "<u8": "<Q"}.items()
}
_RECORD: Final = (
    "position_um",
    "position_steps",
    "trigger_id",
    "camera_frame_id",
    "exposure_start_ns",
    "attempt",
    "crc32",
)

_UNWRITTEN: Final = {"trigger_id": -1, "camera_frame_id": -1, "exposure_start_ns": 0}
"""What a field of a frame holds before its record is written; drivers may leave it so for all frames."""


def write_at(fd: int, data: bytes | memoryview, offset: int) -> None:
    """Write all of ``data`` at ``offset``; the kernel may take it in several pieces."""
    written = os.pwrite(fd, data, offset)
    if written == memoryview(data).nbytes:
        return
    view, offset = memoryview(data).cast("B")[written:], offset + written
    while view:
        written = os.pwrite(fd, view, offset)
        view, offset = view[written:], offset + written


class FrameRefusedError(ScanFileError):
    """A frame was refused; the file is unchanged."""

    def __init__(self, reason: Refusal, text: str) -> None:
        super().__init__(text)
        self.reason: Refusal = reason


class ScanStore:
    """An open scan file with its commit records in memory. Readers and one syncing thread may run in parallel."""

    def __init__(self, path: Path, *, writable: bool) -> None:
        """Open the scan file at ``path``.

        Raises:
            ScanFileError: no scan, damaged or truncated.
            DiskError: it cannot be opened.
        """
        self.path = path
        self.layout: ScanLayout = read_layout(path)
        self._numbers = {
            name: (_PACK[region.dtype.str], region.offset)
            for name, region in self.layout.regions.items()
            if region.dtype.str in _PACK
        }
        """How a number of a region is packed, and where its first one stands."""
        with ScanReader(path) as reader:
            self._status = reader.status().copy()
            self._crc32 = reader.field("crc32").copy()
            self.durable_count = int(reader.scalar("durable_count"))
            self.outcome = reader.outcome
        try:
            self._fd = os.open(path, (os.O_RDWR if writable else os.O_RDONLY) | os.O_CLOEXEC)
        except OSError as error:
            raise disk_error(error, path, "open") from None

    def close(self) -> None:
        """Close the file; idempotent."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    # ---- contents ----

    @property
    def count(self) -> int:
        """Number of frames of the plan."""
        return self.layout.count

    @property
    def committed_count(self) -> int:
        """Number of frames that are good or re-taken."""
        return int(np.count_nonzero(self._usable()))

    @property
    def prefix(self) -> int:
        """Frames 0..prefix-1 are all committed."""
        usable = self._usable()
        return self.count if usable.all() else int(np.argmin(usable))

    def committed_ranges(self) -> list[tuple[int, int]]:
        """Committed frames as ranges [first, last], both ends included."""
        return ranges_of(np.flatnonzero(self._usable()).tolist())

    def committed_crc32(self) -> list[int]:
        """Checksums of the committed frames in order."""
        return [int(value) for value in self._crc32[self._usable()]]

    def missing_ranges(self) -> list[tuple[int, int]]:
        """Frames that are missing or damaged as ranges [first, last]."""
        return ranges_of(np.flatnonzero(~self._usable()).tolist())

    def _usable(self) -> NDArray[np.bool_]:
        usable: NDArray[np.bool_] = (self._status == FrameStatus.GOOD) | (self._status == FrameStatus.RETAKEN)
        return usable

    # ---- reading and writing at offsets ----

    @contextmanager
    def _disk(self, doing: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise disk_error(error, self.path, doing, self.layout.frame_nbytes) from None

    def _put_pixels(self, region: str, index: int, raw: memoryview) -> None:
        write_at(self._fd, raw, self.layout.regions[region].offset + index * self.layout.frame_nbytes)

    def _put_record(self, image: Image) -> None:
        for name in _RECORD:
            self._put(name, image.frame_index, getattr(image, name))

    def _put(self, region: str, index: int, value: float) -> None:
        packed, offset = self._numbers[region]
        write_at(self._fd, packed.pack(value), offset + index * packed.size)

    def _put_text(self, region: str, text: str, size: int) -> None:
        # cut between characters, never within one
        raw = text.encode()[:size].decode(errors="ignore").encode()
        write_at(self._fd, raw.ljust(size, b"\0"), self.layout.regions[region].offset)

    def _put_outcome(self, outcome: Outcome, reason: str) -> None:
        with self._disk("write the outcome of"):
            self._put_text("reason", reason, REASON_BYTES)
            self._put_text("outcome", outcome.value, OUTCOME_BYTES)
        self.outcome = outcome.value

    def _put_measured(self, measured: Mapping[str, float]) -> None:
        """Written whole or not at all: truncated JSON cannot be read."""
        raw = json.dumps({name: value for name, value in measured.items() if math.isfinite(value)})
        if MEASURED in self.layout.regions and len(raw) <= MEASURED_BYTES:
            with self._disk("write what was measured in"):
                self._put_text(MEASURED, raw, MEASURED_BYTES)

    def _get(self, region: str, index: int) -> int:
        packed, offset = self._numbers[region]
        return int(packed.unpack(os.pread(self._fd, packed.size, offset + index * packed.size))[0])

    def _get_text(self, region: str) -> str:
        place = self.layout.regions[region]
        return os.pread(self._fd, place.nbytes, place.offset).rstrip(b"\0").decode("utf-8", "replace")

    def _get_pixels(self, frame_index: int) -> bytes:
        return os.pread(self._fd, self.layout.frame_nbytes, self.layout.frame_offset(frame_index))

    def _put_again(self, frame_index: int) -> None:
        self._put_pixels("data", frame_index, memoryview(self._get_pixels(frame_index)))
        # take the status from memory: it was acknowledged, and the disk has just failed
        self._put("status", frame_index, int(self._status[frame_index]))
        for name in (field for field in FRAME_FIELDS if field != "status"):
            place = self.layout.regions[name]
            offset = place.offset + frame_index * place.dtype.itemsize
            write_at(self._fd, os.pread(self._fd, place.dtype.itemsize, offset), offset)

    # ---- verifying ----

    def check_frames(self, first: int = 0) -> list[int]:
        """Compare the committed frames from ``first`` on with their checksums; mark those that differ as damaged.

        Returns:
            the indices of the damaged ones.
        """
        damaged = []
        room = memoryview(bytearray(self.layout.frame_nbytes))
        for frame_index in (int(found) for found in np.flatnonzero(self._usable()[first:]) + first):
            with self._disk("read"):
                read = os.preadv(self._fd, [room], self.layout.frame_offset(frame_index))
                sound = frame_crc32(room[:read]) == self._get("crc32", frame_index)
            if not sound:
                damaged.append(frame_index)
                self.mark_damaged(frame_index)
        return damaged

    def check_records(self, first: int = 0) -> list[int]:
        """Mark frames from ``first`` on whose record a power cut took: pixels have a checksum, records have none.

        A field that still has its initial value, where other frames of the scan have another, was lost.
        """
        usable = np.flatnonzero(self._usable())
        lost = np.zeros(self.count, np.bool_)
        for name, unwritten in _UNWRITTEN.items():
            values = self._get_all(name)
            if (values[usable] != unwritten).any():
                lost |= values == unwritten
        lost |= (self._status == FrameStatus.RETAKEN) != (self._get_all("attempt") > 0)
        found = [int(frame_index) for frame_index in usable if frame_index >= first and lost[frame_index]]
        for frame_index in found:
            self.mark_damaged(frame_index)
        return found

    def _get_all(self, region: str) -> NDArray[np.int64]:
        place = self.layout.regions[region]
        with self._disk("read"):
            raw = os.pread(self._fd, place.nbytes, place.offset)
        return np.frombuffer(raw, place.dtype).astype(np.int64)

    def mark_damaged(self, frame_index: int) -> None:
        """Mark a frame as damaged because its pixels do not match its checksum; it can be taken again."""
        with self._disk("mark a damaged frame in"):
            self._put("status", frame_index, FrameStatus.DAMAGED)
            if self.durable_count > frame_index:
                self._put("durable_count", 0, frame_index)
        self._status[frame_index] = FrameStatus.DAMAGED
        self.durable_count = min(self.durable_count, frame_index)
