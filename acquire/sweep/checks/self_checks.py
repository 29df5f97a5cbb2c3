"""The checks of a sweep and what they measured, by the names in the end message."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from acquire.sweep.actions import SavePicture
from acquire.sweep.settings import SweepSettings

from .drift import measure_drift
from .light_monitor import LightMonitor
from .overlap import compare_overlap, overlap_complaint, overlap_picture

LIGHT_CHANGED_AT = "light_changed_at"
"""The first frame in another light than those before it; a resumed sweep keeps that of its first part."""


class SelfChecks:
    """Overlap after a resume, light during the sweep, drift and lost steps at its end."""

    def __init__(self, settings: SweepSettings) -> None:
        self._settings = settings
        self.measured: dict[str, float] = {} if settings.resume is None else dict(settings.resume.marks)
        self.complaint = "" if settings.resume is None else "the frame did not arrive"
        """Why a resumed sweep must not go on; empty once the overlap check has passed."""
        self.first: NDArray[Any] | None = None if settings.resume is None else settings.resume.first
        """Frame 0; None before it was taken."""
        self.light = LightMonitor((1 << settings.format.bit_depth) - 1)
        self._light_is_judged = False

    def compare_overlap(self, pixels: NDArray[Any]) -> SavePicture:
        """A resumed sweep took its last frame again: compare it with the stored one; returns both as a picture."""
        resume = self._settings.resume
        assert resume is not None
        found = compare_overlap(resume.stored, pixels, resume.before, self._settings.plan.pitch_steps)
        self.measured |= found
        self.complaint = overlap_complaint(found, resume.limits)
        return SavePicture("overlap.png", overlap_picture(resume.stored, pixels))

    def note_light_change(self, since: int) -> dict[str, float]:
        """The light changed at frame ``since``; returns the mark for the scan's folder.

        The operator decides: to resume the sweep is to accept the light.
        """
        self.light.forget()
        self._light_is_judged = True
        self.measured.setdefault(LIGHT_CHANGED_AT, float(since))
        return {LIGHT_CHANGED_AT: self.measured[LIGHT_CHANGED_AT]}

    def accept_light(self) -> None:
        """The operator resumes: the next frames are compared with the light as it is now."""
        if self._light_is_judged:
            self._light_is_judged = False
            self.light.forget()

    def light_note(self) -> str:
        """The part of the end's reason that says where the light changed; empty where it did not."""
        changed_at = self.measured.get(LIGHT_CHANGED_AT)
        return "" if changed_at is None else f"F27 the light changed at frame {changed_at:.0f}"

    def compare_first(self, repeated: NDArray[Any]) -> None:
        """Frame 0 was taken again after the last one: measure the drift."""
        assert self.first is not None
        self.measured |= measure_drift(self.first, repeated)
