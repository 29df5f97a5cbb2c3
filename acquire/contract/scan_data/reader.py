"""Read a scan at any time without disturbing its writer: the layout once through HDF5, then pread at offsets."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.files import read_text, replace_file

from .dataset_names import CHECK_ROLES, MARKS_NAME, MEASURED, MEASURED_BYTES, FrameStatus
from .file_layout import read_layout


def read_marks(folder: Path) -> dict[str, float]:
    """``marks.json`` beside a scan: what was measured so far, by the names of ``End.checks``; empty without one."""
    try:
        return _numbers(read_text(folder / MARKS_NAME, MEASURED_BYTES))
    except (OSError, ValueError):
        return {}


def write_marks(folder: Path, measured: dict[str, float]) -> None:
    """Write ``marks.json``; not synced to disk, because a sweep does not wait for it.

    Raises:
        OSError: the disk refused.
    """
    replace_file(folder / MARKS_NAME, msgspec.json.encode(measured))


def _numbers(text: str) -> dict[str, float]:
    try:
        return msgspec.json.decode(text or "{}", type=dict[str, float])
    except msgspec.MsgspecError:
        return {}


class ScanReader:
    """A scan, partial or sealed. Every call reads the file anew, so each commit is seen at once."""

    def __init__(self, scan: Path) -> None:
        """Open SCAN (a folder or its .h5).

        Raises:
            ScanFileError: as :func:`read_layout`.
        """
        self.layout = read_layout(scan)
        self._fd = os.open(self.layout.path, os.O_RDONLY | os.O_CLOEXEC)

    def close(self) -> None:
        """Close the file; idempotent."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def count(self) -> int:
        """Number of frames of the plan."""
        return self.layout.count

    def field(self, name: str) -> NDArray[Any]:
        """A per-frame dataset as it is now, shape [n]."""
        region = self.layout.regions[name]
        return np.frombuffer(self._read(region.offset, region.nbytes), dtype=region.dtype).reshape(region.shape)

    def scalar(self, name: str) -> int | str:
        """A scalar of ``dataset_names.SCALARS`` as it is now; fixed bytes become text."""
        region = self.layout.regions[name]
        raw = self._read(region.offset, region.nbytes)
        if region.dtype.kind == "S":
            return raw.rstrip(b"\0").decode("utf-8", "replace")
        return int(np.frombuffer(raw, dtype=region.dtype)[0])

    @property
    def measured(self) -> dict[str, float]:
        """Measurements of the sweep by their names in ``End.checks``; before the scan is sealed those of marks.json."""
        found = read_marks(self.layout.path.parent)
        if MEASURED in self.layout.regions:
            found |= _numbers(str(self.scalar(MEASURED)))
        return found

    def other_light(self) -> NDArray[np.bool_]:
        """Frames that were exposed after the light had changed (F27), bool [n]; by place, and by time if re-taken."""
        changed_at = self.measured.get("light_changed_at", -1.0)
        if not 0 <= changed_at < self.count:
            return np.zeros(self.count, np.bool_)
        first, exposed_ns = int(changed_at), self.field("exposure_start_ns")
        later = (exposed_ns > exposed_ns[first]) & (exposed_ns[first] > 0)
        found: NDArray[np.bool_] = self.present() & (later | (np.arange(self.count) >= first))
        return found

    @property
    def outcome(self) -> str:
        """One of ``states.Outcome``."""
        return str(self.scalar("outcome"))

    def status(self) -> NDArray[np.uint8]:
        """Commit records, uint8 [n] (``dataset_names.FrameStatus``)."""
        return self.field("status")

    def present(self) -> NDArray[np.bool_]:
        """Which frames can be used: good or re-taken, bool [n]."""
        status = self.status()
        present: NDArray[np.bool_] = (status == FrameStatus.GOOD) | (status == FrameStatus.RETAKEN)
        return present

    def committed_through(self) -> int:
        """Last frame index such that it and all before it are committed (or damaged); -1 for none."""
        missing = np.flatnonzero(self.status() == FrameStatus.MISSING)
        return int(missing[0]) - 1 if missing.size else self.count - 1

    def frame(self, frame_index: int, out: NDArray[Any] | None = None) -> NDArray[Any]:
        """Pixels of one frame as stored: [h, w] or [h, w, 3] RGB, read-only; or ``out``, filled with them.

        ``out`` (contiguous, of the stored shape and type) spares a reader of many frames the time for fresh memory.

        Raises:
            IndexError: no such frame in the plan.
            ScanFileError: the file was cut short.
        """
        if out is not None:
            self.read_rows(frame_index, 0, out)
            return out
        if not 0 <= frame_index < self.count:
            raise IndexError(f"frame {frame_index} of {self.count}")
        raw = self._read(self.layout.frame_offset(frame_index), self.layout.frame_nbytes)
        return np.frombuffer(raw, dtype=self.layout.format.dtype).reshape(self.layout.format.shape)

    def read_rows(self, frame_index: int, first_row: int, out: NDArray[Any]) -> None:
        """Fill ``out`` ([rows, w] or [rows, w, 3], contiguous) with rows of a stored frame from ``first_row`` on.

        Raises:
            IndexError: no such frame or rows.
            ScanFileError: the file was cut short.
        """
        form = self.layout.format
        if not (0 <= frame_index < self.count and 0 <= first_row <= form.height - len(out)):
            raise IndexError(f"rows {first_row} to {first_row + len(out) - 1} of frame {frame_index} of {self.count}")
        offset = self.layout.frame_offset(frame_index) + first_row * (form.nbytes // form.height)
        target = out.reshape(-1).view(np.uint8).data
        read = 0
        while read < len(target):
            more = os.preadv(self._fd, [target[read:]], offset + read)
            if more == 0:
                raise ScanFileError(f"{self.layout.path} ends at byte {offset + read}: it was cut short")
            read += more

    def mapped(self) -> NDArray[Any]:
        """All frames as stored, [n, h, w] or [n, h, w, 3], mapped into memory: for reading single pixels of many.

        Read-only; committed frames never change, others may. Valid as long as something refers to it, whatever the
        file is called meanwhile; ask :meth:`check_length` before reading, because what was cut off kills the process.

        Raises:
            ScanFileError: the file was cut short.
        """
        self.check_length()
        region = self.layout.regions["data"]
        with os.fdopen(os.dup(self._fd), "rb") as file:
            pages = np.memmap(file, region.dtype, "r", region.offset, region.shape)
        return np.asarray(pages)

    def check_length(self) -> None:
        """Refuse a file that was cut short after it was opened.

        Raises:
            ScanFileError: it was.
        """
        region = self.layout.regions["data"]
        if os.fstat(self._fd).st_size < region.offset + region.nbytes:
            raise ScanFileError(f"{self.layout.path} was cut short; restore it from a copy")

    def frames(self, first: int = 0, last: int | None = None) -> Iterator[tuple[int, NDArray[Any]]]:
        """Present frames from ``first`` through ``last`` (both included) in order, with their index."""
        present = self.present()
        for frame_index in range(first, self.count if last is None else last + 1):
            if present[frame_index]:
                yield frame_index, self.frame(frame_index)

    def check_frame(self, role: str) -> NDArray[Any] | None:
        """The dark, ambient or repeated frame; None where it was not taken."""
        if "checks/status" not in self.layout.regions:
            return None
        index = CHECK_ROLES.index(role)
        if self.field("checks/status")[index] != FrameStatus.GOOD:
            return None
        size = self.layout.frame_nbytes
        raw = self._read(self.layout.regions["checks/data"].offset + index * size, size)
        return np.frombuffer(raw, dtype=self.layout.format.dtype).reshape(self.layout.format.shape)

    def _read(self, offset: int, size: int) -> bytes:
        raw = os.pread(self._fd, size, offset)
        while len(raw) < size:
            more = os.pread(self._fd, size - len(raw), offset + len(raw))
            if not more:
                raise ScanFileError(f"{self.layout.path} ends at byte {offset + len(raw)}: it was cut short")
            raw += more
        return raw
