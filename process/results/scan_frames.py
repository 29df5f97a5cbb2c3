"""Frames of a scan file for the fold: stored pixels become grey or RGB, and damaged frames count as missing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.scan_data.bayer import BAYER, demosaiced
from acquire.contract.scan_data.checksums import frame_crc32, scan_digest
from acquire.contract.scan_data.reader import ScanReader
from process.edge_fit.pixel_columns import ReadColumns, gathered
from process.fold.fold import to_grey


class ScanFrames(ScanReader):
    """A scan whose frames are read as the fold takes them, each checked against its checksum."""

    def __init__(self, scan: Path) -> None:
        """Open SCAN.

        Raises:
            ScanFileError: as ``ScanReader``.
        """
        try:
            super().__init__(scan)
        except FileNotFoundError:  # the writer sealed, and so renamed, the file at this moment
            super().__init__(scan)
        self.damaged: set[int] = set()
        """Frames whose stored pixels do not have their checksum; they are treated as missing."""
        self._mapped: NDArray[Any] | None = None
        self._scratch: NDArray[Any] | None = None

    def close(self) -> None:
        """Close the file; may be called again."""
        self._mapped = None
        super().close()

    def digest(self) -> str:
        """Digest over the frames that are present now."""
        return scan_digest(np.where(self.present(), self.field("crc32"), 0).astype(np.uint32))

    def pixels(self, frame_index: int, crc32: int, room: NDArray[Any] | None = None) -> NDArray[Any] | None:
        """Grey or RGB pixels of a committed frame; None (and ``damaged``) if they do not have this checksum.

        With ``room`` ([h, w] of the stored type) a grey frame is read into it, and any other into memory of this
        object, where the next one replaces it: fresh memory for each frame costs more time than reading it.
        """
        stored = self.frame(frame_index, None if room is None else self._target(room))
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

    def columns_of(self, frames: NDArray[np.int64]) -> ReadColumns:
        """A function that reads the grey levels of single pixels over ``frames``; equal to those of the whole frames.

        Raises:
            ScanFileError: the file was cut short.
        """
        form = self.layout.format
        if self._mapped is None:
            self._mapped = self.mapped()
        stored = self._mapped
        if form.pixel_format in BAYER or not stored.flags.aligned:
            return lambda pixels, first, end: self._rows_of(frames, pixels, first, end)
        stack = stored.reshape(len(stored), form.height * form.width, -1)

        def read(pixels: NDArray[np.int64], first: NDArray[np.int64], end: NDArray[np.int64]) -> NDArray[Any]:
            self.check_length()
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
                self.read_rows(int(frames[place]), begin, band)
                grey = to_grey(demosaiced(band, form.pixel_format), form.bit_depth)
                out[some, place - first[some]] = grey.reshape(-1)[inside[some]]
        return out


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
