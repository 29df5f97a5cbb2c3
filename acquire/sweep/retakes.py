"""Retakes: which frames of the plan have arrived, how often each was lost, and which the next run takes. Pure.

A lost frame is not entered as taken, so the next run includes it. :func:`.state_machine._retake` decides whether the
run is stopped for it, or the sweep ends because the frame was lost too often.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from .pairing import Shot


@dataclass
class Retakes:
    """The frames of one sweep by index."""

    count: int
    """Frames of the plan."""
    max_attempts: int
    """A frame that is lost so often ends the sweep."""
    taken: set[int] = field(default_factory=set)
    """Frames that arrived and were paired with their trigger."""
    attempts: dict[int, int] = field(default_factory=dict)
    """Lost attempts by frame index."""

    def lose(self, shots: Iterable[Shot]) -> Shot | None:
        """Count a lost attempt for each shot; returns the first that was lost too often, None when there is none."""
        for shot in shots:
            self.attempts[shot.frame_index] = self.attempts.get(shot.frame_index, 0) + 1
            if self.attempts[shot.frame_index] >= self.max_attempts:
                return shot
        return None

    def next_run(self) -> tuple[int, int] | None:
        """First and last index of the first gap in the taken frames; None if there is no gap."""
        first = next((k for k in range(self.count) if k not in self.taken), None)
        if first is None:
            return None
        return first, next((k for k in range(first, self.count) if k in self.taken), self.count) - 1
