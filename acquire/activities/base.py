"""What one activity beside no sweep looks like to the interlude that runs it: an exposure search, a pre-scan, a jog."""

from __future__ import annotations

from typing import ClassVar

from acquire.cameras.protocol import CameraFrame
from acquire.stages.protocol import Moved, SegmentDone, Stopped

Rest = Moved | Stopped | SegmentDone
"""Events that say that the stage rests."""


class Activity:
    """One thing that the rig does by itself; a device's ``SweepscopeError`` ends it, in that error's words."""

    name: ClassVar[str] = ""
    """As it stands in the status."""
    moves: ClassVar[bool] = False
    """The rig is MOVING while it runs; else it is in PREVIEW."""
    snaps: ClassVar[bool] = False
    """It takes pictures of its own: those of the preview rest meanwhile."""

    def __init__(self) -> None:
        self.share = 0.0
        """How far it is, 0..1."""
        self.ended = ""
        """How it ended, in words; empty while it runs."""
        self.failed = False

    def end(self, words: str, *, failed: bool = False) -> None:
        """It is over."""
        self.ended, self.failed = words, failed

    def begin(self, now_ns: int) -> None:
        """Do the first thing."""

    def on_rest(self, event: Rest, now_ns: int) -> None:
        """The stage rests."""

    def on_frame(self, frame: CameraFrame, now_ns: int) -> None:
        """The picture came that was asked for."""

    def on_no_frame(self, now_ns: int) -> None:
        """The picture that was asked for did not come in time."""
        self.end("no usable picture came from the camera: is it connected?", failed=True)

    def on_tick(self, now_ns: int) -> None:
        """Time has passed."""

    def cancel(self) -> None:
        """It was stopped: put back what must not stay changed. The stage is stopped by whoever cancels."""
