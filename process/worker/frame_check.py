"""Check a live frame before it is folded: is it of this scan, of its format, and whole?"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.messaging.messages import Image
from acquire.contract.scan_data.checksums import frame_crc32

from .scan_description import ScanDescription


@dataclass
class RefusedFrames:
    """Live frames that were not folded, by reason; the file has them all."""

    foreign: int = 0
    """Of another scan."""
    malformed: int = 0
    """Another shape, type, length, or an index beyond the plan."""
    wrong_crc: int = 0
    raised: int = 0
    """The fold raised on them."""

    def report_counts(self) -> dict[str, int]:
        """For the report: ``live_foreign`` ..."""
        return {f"live_{name}": number for name, number in dataclasses.asdict(self).items()}


class FrameCheck:
    """Lets frames of one scan through, and counts the others."""

    def __init__(self, description: ScanDescription) -> None:
        form = description.recorded.format
        self._scan_uid, self._count = description.scan_uid, description.count
        self._dtype, self._shape, self._nbytes = np.dtype(form.dtype), form.shape, form.nbytes
        self._header = (list(form.shape), form.dtype, form.bit_depth, form.pixel_format)
        self.refused = RefusedFrames()

    def is_of_this_sweep(self, image: Image) -> bool:
        """True for a frame of the sweep itself; dark, ambient and repeated frames are none."""
        if image.scan_uid != self._scan_uid:
            self.refused.foreign += 1
            return False
        if image.frame_index >= self._count:
            self.refused.malformed += 1
            return False
        return image.role == "sweep"

    def pixels(self, image: Image, payload: memoryview) -> NDArray[Any] | None:
        """The frame's pixels as stored, without a copy; None if they do not match the header or the scan."""
        header = (image.shape, image.dtype, image.bit_depth, image.pixel_format)
        if header != self._header or payload.nbytes != self._nbytes:
            self.refused.malformed += 1
            return None
        if frame_crc32(payload) != image.crc32:
            self.refused.wrong_crc += 1
            return None
        return np.frombuffer(payload, self._dtype).reshape(self._shape)
