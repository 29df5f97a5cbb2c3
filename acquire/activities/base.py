"""What one activity (an exposure search, a pre-scan, a held jog) must do for the runner."""

from __future__ import annotations

from typing import ClassVar

from acquire.cameras.protocol import CameraFrame
from acquire.stages.protocol import Moved, SegmentDone, Stopped

Rest = Moved | Stopped | SegmentDone
"""Events that say that the stage rests."""


class Activity:
    """One thing that the rig does by itself while no scan runs.

    A device's ``SweepscopeError`` ends it; its text is shown as the reason.
    """

    name: ClassVar[str] = ""
    """As the status message names it."""
    moves: ClassVar[bool] = False
    """The rig is MOVING while it runs; else it is in PREVIEW."""
    snaps: ClassVar[bool] = False
    """It takes pictures of its own; the preview takes none meanwhile."""

    def __init__(self) -> None:
        self.share = 0.0
        """Progress, 0..1."""
        self.ended = ""
        """How it ended; empty while it runs."""
        self.failed = False

    def end(self, text: str, *, failed: bool = False) -> None:
        """It is over."""
        self.ended, self.failed = text, failed

    def begin(self, now_ns: int) -> None:
        """Start."""

    def on_rest(self, event: Rest, now_ns: int) -> None:
        """The stage rests."""

    def on_frame(self, frame: CameraFrame, now_ns: int) -> None:
        """The picture that was asked for has come."""

    def on_no_frame(self, now_ns: int) -> None:
        """The picture that was asked for did not come in time."""
        self.end("no usable picture came from the camera: is it connected?", failed=True)

    def on_tick(self, now_ns: int) -> None:
        """Time has passed."""

    def cancel(self) -> None:
        """It was stopped: undo what must not stay changed. The caller stops the stage."""
