"""Owns the check of a live frame before anything is made of it: of this scan, of its format, whole."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.messaging.messages import Image
from acquire.contract.scan_data.checksums import frame_crc32

from .scan_description import Announced


@dataclass
class LiveCounts:
    """Live frames that were not folded, by reason; the file has them all."""

    foreign: int = 0
    """Of another scan."""
    malformed: int = 0
    """Another shape, type, length, or an index beyond the plan."""
    wrong_crc: int = 0
    raised: int = 0
    """The fold raised on them."""

    def named(self) -> dict[str, int]:
        """For the report: ``live_foreign`` ..."""
        return {f"live_{name}": number for name, number in dataclasses.asdict(self).items()}


class LiveGate:
    """Lets frames of one scan through."""

    def __init__(self, announced: Announced) -> None:
        self._announced = announced
        self._form = announced.recorded.format
        self.counts = LiveCounts()

    def is_of_this_sweep(self, image: Image) -> bool:
        """True for a frame of the sweep itself; dark, ambient and repeated frames are none."""
        if image.scan_uid != self._announced.scan_uid:
            self.counts.foreign += 1
            return False
        if image.frame_index >= self._announced.count:
            self.counts.malformed += 1
            return False
        return image.role == "sweep"

    def pixels(self, image: Image, payload: memoryview) -> NDArray[Any] | None:
        """The frame's pixels as stored, without a copy; None if they are not what the header or the scan says."""
        form = self._form
        described = (tuple(image.shape), image.dtype, image.bit_depth, image.pixel_format)
        expected = (form.shape, form.dtype, form.bit_depth, form.pixel_format)
        if described != expected or payload.nbytes != form.nbytes:
            self.counts.malformed += 1
            return None
        if frame_crc32(payload) != image.crc32:
            self.counts.wrong_crc += 1
            return None
        return np.frombuffer(payload, dtype=form.dtype).reshape(form.shape)
