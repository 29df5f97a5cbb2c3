"""The bounded window between trigger and commit: who may be triggered, what must be kept. Pure: values in and out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from acquire.contract.messaging.messages import AckItem, Image

FrameKey = tuple[str, int]
"""Role and frame index."""


@dataclass(frozen=True)
class Kept:
    """A frame that is not committed yet; its pixels must not change until it is."""

    image: Image
    pixels: Any


@dataclass
class Window:
    """Frames between their trigger and their commit, and the absolute credit that follows from them.

    Frame n may be triggered only while n <= (last frame of the committed prefix) + slots.
    """

    slots: int
    """Frames that may be uncommitted at a time, at least 1."""
    kept: dict[FrameKey, Kept] = field(default_factory=dict)
    committed: dict[int, int] = field(default_factory=dict)
    """crc32 of each committed sweep frame by its index."""
    prefix: int = 0
    """Frames 0..prefix-1 are all committed."""
    conflicts: int = 0
    """Frames of which the file holds another version, or that it cannot take."""

    def may_trigger_through(self) -> int:
        """The last frame index that has credit (absolute)."""
        return self.prefix + self.slots - 1

    def free(self, triggered_through: int) -> int:
        """Slots that are free when frames up to ``triggered_through`` were triggered."""
        return self.may_trigger_through() - triggered_through

    def keep(self, image: Image, pixels: Any) -> bool:
        """Keep a frame until its ack; False if that frame is committed already and must not be sent."""
        if image.role == "sweep" and image.frame_index in self.committed:
            return False
        self.kept[(image.role, image.frame_index)] = Kept(image, pixels)
        return True

    def commit(self, item: AckItem) -> bool:
        """Take an ack; True if it commits something new. A repeated ack does no harm."""
        key = (item.role, item.frame_index)
        kept = self.kept.get(key)
        if kept is not None and kept.image.crc32 != item.crc32:
            self.conflicts += 1
            return False
        self.kept.pop(key, None)
        if item.role != "sweep" or item.frame_index in self.committed:
            return False
        self.committed[item.frame_index] = item.crc32
        while self.prefix in self.committed:
            self.prefix += 1
        return True

    def revoke(self, missing: list[tuple[int, int]]) -> None:
        """The file does not hold these any more, although it did: ranges [first, last] of frame indices."""
        for frame_index in [k for k in self.committed if any(first <= k <= last for first, last in missing)]:
            del self.committed[frame_index]
            self.prefix = min(self.prefix, frame_index)

    def give_up(self, role: str, frame_index: int) -> None:
        """The writer will never take this frame: it is not kept any more, and counts as a conflict."""
        if self.kept.pop((role, frame_index), None) is not None:
            self.conflicts += 1

    def is_settled(self) -> bool:
        """True when nothing waits for an ack."""
        return not self.kept

    def kept_bytes(self) -> int:
        """Bytes of pixels that are kept."""
        return sum(memoryview(frame.pixels).nbytes for frame in self.kept.values())


def slots_for(window_bytes: int, frame_bytes: int, wanted: int = 512) -> int:
    """Frames that fit into ``window_bytes``, at most ``wanted``; 0 means that not even two do."""
    slots = min(wanted, window_bytes // frame_bytes)
    return slots if slots >= 2 else 0
