"""Frame credit: how far the stage may trigger, from what the writer has committed. Pure: values in and out.

Frame n may be triggered only while n <= (last frame of the committed prefix) + slots. This bounds the frames between
trigger and commit, and the memory that they need.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from acquire.contract.messaging.messages import AckItem, Image

FrameKey = tuple[str, int]
"""Role and frame index."""


@dataclass
class CreditWindow:
    """Frames that are committed or on their way to the writer, and the credit of the running segment."""

    slots: int
    """Frames that may be uncommitted at a time, at least 1."""
    unacked: dict[FrameKey, int] = field(default_factory=dict)
    """crc32 of each frame that was published and is not committed yet."""
    committed: dict[int, int] = field(default_factory=dict)
    """crc32 of each committed sweep frame by its index."""
    prefix: int = 0
    """Frames 0..prefix-1 are all committed."""
    conflicts: int = 0
    """Frames that the file contains with other pixels, or that it will never take."""
    triggered_through: int = -1
    """The highest frame that was triggered in the segment; the one before its first where none was."""
    holds: int = 0
    """How often the stage had to wait for credit."""
    short: bool = False
    """The stage waits for credit, until half the window is free."""
    running: bool = False
    """A segment is under way."""
    first: int = 0
    """First frame of the segment."""
    _granted: int = -1
    _last: int = -1
    _gated: bool = True

    # ---- what is committed ----

    def publish(self, image: Image) -> None:
        """A frame is on its way to the writer, unless it is committed already."""
        if image.role != "sweep" or image.frame_index not in self.committed:
            self.unacked[image.role, image.frame_index] = image.crc32

    def commit(self, items: Iterable[AckItem]) -> None:
        """Take acks. A repeated ack has no effect; one with another checksum commits nothing."""
        for item in items:
            key = (item.role, item.frame_index)
            if self.unacked.get(key, item.crc32) != item.crc32:
                self.conflicts += 1
                continue
            self.unacked.pop(key, None)
            if item.role == "sweep":
                self.committed.setdefault(item.frame_index, item.crc32)
        while self.prefix in self.committed:
            self.prefix += 1

    def refuse(self, role: str, frame_index: int) -> None:
        """The writer will never take this frame: its ack is no longer awaited."""
        if self.unacked.pop((role, frame_index), None) is not None:
            self.conflicts += 1

    def revoke(self, missing: Iterable[tuple[int, int]]) -> None:
        """The file lost these committed frames: ranges [first, last] of frame indices."""
        for frame_index in [k for k in self.committed if any(first <= k <= last for first, last in missing)]:
            del self.committed[frame_index]
            self.prefix = min(self.prefix, frame_index)

    # ---- the credit of a segment ----

    def may_trigger_through(self) -> int:
        """The last frame index that has credit (absolute)."""
        return self.prefix + self.slots - 1

    def free(self) -> int:
        """Slots left for frames that are not triggered yet; 0 or less: none."""
        return self.may_trigger_through() - self.triggered_through

    def begin(self, first: int, last: int, *, gated: bool, ahead: int | None) -> int:
        """A segment over the frames first..last begins; returns the last of its shots that may be fired at once.

        Args:
            first: index of its first frame.
            last: index of its last frame.
            gated: False for a check frame, which needs no credit.
            ahead: triggers that may be fired before the next frame arrives; None: any number.
        """
        self.first, self._last, self._gated, self.running = first, last, gated, True
        self.triggered_through = first - 1
        self._granted = self._credit(ahead) if gated else last
        return self._granted - self.first

    def trigger(self, frame_index: int) -> bool:
        """Book a trigger; False if the frame had no credit in this segment."""
        if not self.first <= frame_index <= self._granted:
            return False
        self.triggered_through = max(self.triggered_through, frame_index)
        return True

    def grant(self, ahead: int | None) -> int | None:
        """Raise the credit of the segment; returns the last shot that may be fired, None where nothing changes."""
        if not self.running or not self._gated or self._must_wait():
            return None
        credit = self._credit(ahead)
        granted, self._granted = self._granted, max(credit, self._granted)
        return credit - self.first if credit > granted else None

    def awaits_trigger(self) -> bool:
        """True while the stage still has to report a trigger that has credit, or the segment's end."""
        return self.running and (self.triggered_through < self._granted or self.triggered_through == self._last)

    def _must_wait(self) -> bool:
        free = self.free()
        if free <= 0 and self.triggered_through < self._last and not self.short:
            self.short = True
            self.holds += 1
        # hysteresis: one long wait instead of a stop after each frame
        if self.short and free >= max(1, self.slots // 2):
            self.short = False
        return self.short

    def _credit(self, ahead: int | None) -> int:
        through = min(self.may_trigger_through(), self._last)
        return through if ahead is None else min(through, self.triggered_through + ahead)


def slots_for(window_bytes: int, frame_bytes: int, wanted: int = 512) -> int:
    """Frames that fit into ``window_bytes``, at most ``wanted``; 0 means that not even two do."""
    slots = min(wanted, window_bytes // frame_bytes)
    return slots if slots >= 2 else 0
