"""Frames that wait until the controller confirms that it did not stop during their exposure.

An emergency stop or a restart of the controller puts the lamp out. The dark frame of that moment arrives before the
alarm; committed, it could not be taken again. So a frame is published only after the controller was heard to be
without an alarm after the end of its exposure.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from .actions import Publish


@dataclass
class Confirmation:
    """Frames in, frames out, in order. The credit window bounds how many can wait. Pure."""

    needed: bool
    """False where stage and lamp are driven by the host: nothing can happen to them that it does not know."""
    _waiting: deque[tuple[int, Publish]] = field(default_factory=deque)

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, publish: Publish, exposed_until_ns: int) -> list[Publish]:
        """Take a frame; returns what may be published at once."""
        if not self.needed:
            return [publish]
        self._waiting.append((exposed_until_ns, publish))
        return []

    def confirm(self, no_alarm_ns: int | None) -> list[Publish]:
        """The controller was without an alarm at ``no_alarm_ns`` (CLOCK_MONOTONIC): frames exposed by then."""
        found = []
        while self._waiting and no_alarm_ns is not None and self._waiting[0][0] <= no_alarm_ns:
            found.append(self._waiting.popleft()[1])
        return found

    def drop(self) -> list[int]:
        """Give all up; returns the frame indices of those of the sweep."""
        images = [publish.image for _, publish in self._waiting]
        self._waiting.clear()
        return [image.frame_index for image in images if image.role == "sweep"]
