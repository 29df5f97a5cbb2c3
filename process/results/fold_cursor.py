"""Feed a fold in order: frame k only after 0..k-1, from the live lane or the file, each identified by its checksum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from process.fold.fold import Fold

from .scan_frames import ScanFrames


@dataclass
class CursorCounts:
    """Where the frames of the fold came from; from_live + from_file is what the fold holds."""

    from_live: int = 0
    from_file: int = 0
    refolded: int = 0
    """Frames that had been folded when the fold had to start again."""
    buffer_full: int = 0
    """Live frames that came early and found the buffer full; they are read from the file instead."""


class FoldCursor:
    """Feeds one fold in order.

    Live frames that come early wait in a small buffer; a gap is filled from the file as soon as the frame is
    committed there, and skipped only once it is known that it never will be.
    """

    def __init__(self, new_fold: Callable[[], Fold], count: int, buffer_frames: int) -> None:
        """For ``count`` frames; at most ``buffer_frames`` live frames wait for a gap to be filled."""
        self._new_fold = new_fold
        self._room = buffer_frames
        self._waiting: dict[int, tuple[int, NDArray[Any]]] = {}
        self.count = count
        self.counts = CursorCounts()
        self.fold = new_fold()
        self.next_index = 0
        """The first frame that is neither folded nor skipped."""
        self.folded = np.zeros(count, dtype=np.bool_)
        self.crc32 = np.zeros(count, dtype=np.uint32)

    @property
    def done(self) -> bool:
        """True if every frame is folded or skipped."""
        return self.next_index >= self.count

    def wants(self, frame_index: int) -> bool:
        """True if :meth:`offer` has a use for this frame; a frame that finds the buffer full is counted."""
        if not self.next_index <= frame_index < self.count:
            return False
        if frame_index > self.next_index and frame_index not in self._waiting and len(self._waiting) >= self._room:
            self.counts.buffer_full += 1
            return False
        return True

    def offer(self, frame_index: int, crc32: int, pixels: NDArray[Any]) -> bool:
        """Fold a live frame whose checksum is right, and the frames that waited for it.

        Returns:
            True if a frame was folded. One that the cursor has passed is ignored: if it differs, the comparison at
            the end finds it.

        Raises:
            ValueError: the fold cannot take these pixels; :meth:`restart` it.
        """
        if not self.wants(frame_index):
            return False
        if frame_index > self.next_index:
            self._waiting[frame_index] = (crc32, pixels)
            return False
        self._add(frame_index, crc32, pixels)
        self.counts.from_live += 1
        self._drain()
        return True

    def fill(
        self, file: ScanFrames, *, limit: int, through: int | None = None, never: NDArray[np.bool_] | None = None
    ) -> int:
        """Fold up to ``limit`` frames from the file, and live frames that follow them.

        Args:
            file: the scan.
            limit: most frames read in this call, so that the caller can serve its sockets in between.
            through: last frame index to be read; None: any.
            never: frames that will not be committed any more, [n]; they are skipped while they are missing.

        Returns:
            Number of frames read.
        """
        present, crc32 = file.present(), file.field("crc32")
        read = 0
        last = self.count if through is None else through
        while read < limit and not self.done and self.next_index <= last:
            frame_index = self.next_index
            if not present[frame_index]:
                if never is None or not never[frame_index]:
                    break
                self.next_index += 1
                continue
            pixels = file.pixels(frame_index, int(crc32[frame_index]), self.fold.room())
            read += 1
            if pixels is None:
                self.next_index += 1
                continue
            self._add(frame_index, int(crc32[frame_index]), pixels)
            self.counts.from_file += 1
            self._drain()
        return read

    def differs_from(self, file: ScanFrames) -> list[int]:
        """Frames that were folded otherwise than the file has them: other checksum, not in the file, or left out."""
        present, crc32 = file.present(), file.field("crc32")
        wrong = self.folded & (~present | (self.crc32 != crc32))
        wrong |= ~self.folded & present
        return [int(k) for k in np.flatnonzero(wrong) if self.folded[k] or int(k) not in file.damaged]

    def restart(self) -> None:
        """Forget everything folded; the frames are read from the file again."""
        self.counts.refolded += int(self.folded.sum())
        self.counts.from_live = self.counts.from_file = 0
        self._waiting.clear()
        self.fold = self._new_fold()
        self.next_index = 0
        self.folded[:] = False

    def _add(self, frame_index: int, crc32: int, pixels: NDArray[Any]) -> None:
        self.fold.add(frame_index, pixels, keep=True)  # read-only: the fold need not copy it
        self.folded[frame_index] = True
        self.crc32[frame_index] = crc32
        self.next_index = frame_index + 1

    def _drain(self) -> None:
        """Fold the live frames that follow; drop those that the cursor has passed."""
        while (found := self._waiting.pop(self.next_index, None)) is not None:
            self._add(self.next_index, *found)
            self.counts.from_live += 1
        if self._waiting:
            self._waiting = {k: v for k, v in self._waiting.items() if k >= self.next_index}
