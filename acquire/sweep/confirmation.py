"""Frames that wait for the controller's word: one that was exposed while it stopped by itself is never taken for good.

An emergency stop or a restart puts the lamp out. The picture of that moment arrives before the news, and committed it
could not be taken again. So a frame goes on its way only when the controller was heard to be sound after its exposure.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from .actions import Publish


@dataclass
class Unproven:
    """Pure: frames in, frames out, in order. The window of the writer bounds how many there can be."""

    needed: bool
    """False where stage and lamp live in the host: nothing can happen to them unheard."""
    _waiting: deque[tuple[int, Publish]] = field(default_factory=deque)

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, publish: Publish, exposed_until_ns: int) -> list[Publish]:
        """Take a frame; returns what may go on its way at once."""
        if not self.needed:
            return [publish]
        self._waiting.append((exposed_until_ns, publish))
        return []

    def proven(self, sound_ns: int | None) -> list[Publish]:
        """The controller was sound at ``sound_ns`` (CLOCK_MONOTONIC): frames whose exposure had ended by then."""
        found = []
        while self._waiting and sound_ns is not None and self._waiting[0][0] <= sound_ns:
            found.append(self._waiting.popleft()[1])
        return found

    def drop(self) -> list[int]:
        """Give all up; returns the frame indices of those of the sweep."""
        images = [publish.image for _, publish in self._waiting]
        self._waiting.clear()
        return [image.frame_index for image in images if image.role == "sweep"]
