"""What a sweep measures of itself: is the rig where it was, does the light stay, what has drifted at the end?"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from .actions import Attach
from .drift_check import measure_drift
from .light_monitor import LampWatch
from .overlap_check import compare_overlap, overlap_picture
from .settings import SweepSettings

LIGHT_CHANGED_AT = "light_changed_at"
"""The first frame in another light than those before it; a sweep that goes on keeps its past's."""


class Checks:
    """Fed with frames; keeps the figures that stand in the end message, by their names there."""

    def __init__(self, settings: SweepSettings) -> None:
        self._settings = settings
        self.measured: dict[str, float] = {} if settings.resume is None else dict(settings.resume.marks)
        self.complaint = "the frame did not come again"
        """Why a resumed sweep must not go on; empty once the overlap check has passed."""
        self.light_is_judged = False
        """It is paused because the light changed: to resume is to accept the light."""
        self._first = None if settings.resume is None else settings.resume.first
        self._light = LampWatch((1 << settings.format.bit_depth) - 1)

    @property
    def has_first(self) -> bool:
        """True when there is a frame 0 to compare its repetition with."""
        return self._first is not None

    def compare_overlap(self, pixels: NDArray[Any]) -> Attach:
        """Is the rig what it was before the interruption? Returns the picture that shows it."""
        resume = self._settings.resume
        assert resume is not None
        found = compare_overlap(resume.stored, pixels, resume.before, self._settings.plan.pitch_steps)
        self.measured |= found.as_checks()
        self.complaint = found.complaint(resume.limits)
        return Attach("overlap.png", overlap_picture(resume.stored, pixels))

    def look_at(self, frame_index: int, pixels: NDArray[Any], *, watch: bool) -> str:
        """A frame of the sweep. Returns what changed of the light, in words, where it is watched and something did."""
        if frame_index == 0:
            self._first = pixels
        found = self._light.update(frame_index, pixels) if watch else None
        if found is None:
            return ""
        since, what = found
        self._light.forget()
        self.measured.setdefault(LIGHT_CHANGED_AT, float(since))
        self.light_is_judged = True
        return f"{what} since frame {since}"

    def accept_light(self) -> None:
        """The operator goes on: the light as it is now is the light of the frames to come."""
        if self.light_is_judged:
            self.light_is_judged = False
            self._light.forget()

    def light_note(self) -> str:
        """Frames that were taken in another light are marked by it, in the end message and in the file."""
        changed_at = self.measured.get(LIGHT_CHANGED_AT)
        return "" if changed_at is None else f"F27 the light changed at frame {changed_at:.0f}"

    def compare_first(self, repeated: NDArray[Any]) -> None:
        """Frame 0 was taken again after the last one."""
        assert self._first is not None
        self.measured |= measure_drift(self._first, repeated)

    def count_lost_steps(self, steps_lost: int | None) -> None:
        """The limit was touched again; None: this stage cannot tell."""
        if steps_lost is not None:
            self.measured["steps_lost"] = float(steps_lost)
