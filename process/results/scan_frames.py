"""Frames of a scan file for the fold: stored pixels become grey or RGB, and damaged frames count as missing."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.scan_data.bayer import BAYER, demosaiced
from acquire.contract.scan_data.checksums import frame_crc32, scan_digest
from acquire.contract.scan_data.file_layout import ScanLayout
from acquire.contract.scan_data.reader import ScanReader
from process.edge_fit.pixel_columns import ReadColumns, gathered
from process.fold.fold import to_grey


class ScanFrames:
    """The frames of one scan file, checked against their checksums."""

    def __init__(self, scan: Path) -> None:
        """Open SCAN.

        Raises:
            ScanFileError: as ``ScanReader``.
        """
        self._reader = _open(scan)
        self.damaged: set[int] = set()
        """Frames whose stored pixels do not have their checksum; they are treated as missing."""
        self._mapped: NDArray[Any] | None = None
        self._scratch: NDArray[Any] | None = None

    def __enter__(self) -> ScanFrames:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; idempotent."""
        self._mapped = None
        self._reader.close()

    @property
    def layout(self) -> ScanLayout:
        """What never changes."""
        return self._reader.layout

    @property
    def count(self) -> int:
        """Frames of the plan."""
        return self._reader.count

    @property
    def outcome(self) -> str:
        """As it is now; ``running`` until the writer seals."""
        return self._reader.outcome

    @property
    def measured(self) -> dict[str, float]:
        """What was measured around the sweep; empty until it was sealed, and in scans of earlier versions."""
        return self._reader.measured

    def other_light(self) -> NDArray[np.bool_]:
        """Frames that were taken after the light had changed, bool [n]."""
        return self._reader.other_light()

    def usable(self) -> NDArray[np.bool_]:
        """Frames that are committed and good now, [n]."""
        return self._reader.present()

    def status(self) -> NDArray[np.uint8]:
        """Commit records as they are now, [n] (``FrameStatus``)."""
        return self._reader.status()

    def crc32(self) -> NDArray[np.uint32]:
        """Recorded checksums as they are now, [n]; meaningful for present frames."""
        return self._reader.field("crc32")

    def positions_um(self) -> NDArray[np.float64]:
        """Recorded stage positions, [n]; NaN where they are not known."""
        return self._reader.field("position_um")

    def digest(self) -> str:
        """Digest over the frames that are present now."""
        return scan_digest(np.where(self.usable(), self.crc32(), 0).astype(np.uint32))

    def frame(self, frame_index: int, crc32: int, room: NDArray[Any] | None = None) -> NDArray[Any] | None:
        """Grey or RGB pixels of a committed frame; None (and ``damaged``) if they do not have this checksum.

        With ``room`` ([h, w] of the stored type) a grey frame is read into it, and any other into memory of this
        object, where the next one replaces it: fresh memory for each frame costs more time than reading it.
        """
        stored = self._reader.frame(frame_index, None if room is None else self._target(room))
        if frame_crc32(stored) != crc32:
            self.damaged.add(frame_index)
            return None
        return demosaiced(stored, self.layout.format.pixel_format)

    def _target(self, room: NDArray[Any]) -> NDArray[Any]:
        form = self.layout.format
        if form.pixel_format == "mono":
            return room
        if self._scratch is None:
            self._scratch = np.empty(form.shape, np.dtype(form.dtype))
        return self._scratch

    def columns(self, frames: NDArray[np.intp], pixels: NDArray[np.intp]) -> NDArray[Any]:
        """Grey values of a few ``pixels`` (flat indices) in all ``frames``, [len(frames), len(pixels)]."""
        form = self.layout.format
        found = np.empty((len(frames), len(pixels)), np.dtype(form.dtype))
        for row, frame_index in enumerate(frames):
            image = demosaiced(self._reader.frame(int(frame_index)), form.pixel_format)
            chosen = image.reshape(form.height * form.width, -1)[pixels]
            grey = chosen[:, 0] if image.ndim == 2 else to_grey(chosen[None], form.bit_depth)[0]
            found[row] = grey
        return found

    def columns_of(self, frames: NDArray[np.int64]) -> ReadColumns:
        """How the grey levels of single pixels are read over ``frames``, the same as those of the whole frames.

        Raises:
            ScanFileError: the file was cut short.
        """
        form = self.layout.format
        if self._mapped is None:
            self._mapped = self._reader.mapped()
        stored = self._mapped
        if form.pixel_format in BAYER or not stored.flags.aligned:
            return lambda pixels, first, end: self._rows_of(frames, pixels, first, end)
        stack = stored.reshape(len(stored), form.height * form.width, -1)

        def read(pixels: NDArray[np.int64], first: NDArray[np.int64], end: NDArray[np.int64]) -> NDArray[Any]:
            self._reader.check_length()
            values = gathered(stack, frames, pixels, first, end)
            return values.reshape(values.shape[:2]) if values.shape[2] == 1 else to_grey(values, form.bit_depth)

        return read

    def _rows_of(
        self, frames: NDArray[np.int64], pixels: NDArray[np.int64], first: NDArray[np.int64], end: NDArray[np.int64]
    ) -> NDArray[Any]:
        """As ``ReadColumns``, by bands of rows: what a pixel of a mosaic is depends on those around it."""
        form = self.layout.format
        rows = pixels // form.width
        lowest, highest = int(rows.min(initial=form.height)), int(rows.max(initial=0))
        begin = max(lowest - lowest % 2 - 2, 0)
        band = np.empty((max(min(highest + 4, form.height) - begin, 0), *form.shape[1:]), np.dtype(form.dtype))
        inside = pixels - begin * form.width
        out = np.empty((len(pixels), int((end - first).max(initial=0))), band.dtype)
        for place in range(int(first.min(initial=len(frames))), int(end.max(initial=0))):
            some = np.flatnonzero((first <= place) & (place < end))
            if len(some):
                self._reader.read_rows(int(frames[place]), begin, band)
                grey = to_grey(demosaiced(band, form.pixel_format), form.bit_depth)
                out[some, place - first[some]] = grey.reshape(-1)[inside[some]]
        return out


def _open(scan: Path) -> ScanReader:
    """A reader; the writer may give the file its last name between two looks at it."""
    try:
        return ScanReader(scan)
    except FileNotFoundError:
        return ScanReader(scan)


def open_frames(scan: Path, scan_uid: str) -> ScanFrames | None:
    """The frames of the scan with this uid; None while its file is not there or is another scan's."""
    try:
        frames = ScanFrames(scan)
    except (ScanFileError, OSError):
        return None
    if frames.layout.scan_uid != scan_uid:
        frames.close()
        return None
    return frames
