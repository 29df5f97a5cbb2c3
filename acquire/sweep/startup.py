"""A sweep before its first frame: its file is made, the room's light is taken, the lamp is warm. Nothing moves."""

from __future__ import annotations

from dataclasses import dataclass, field

from .actions import Action, Say, SetLamp, Snap
from .events import WriterReady
from .phases import Deadline, Phase
from .settings import SweepSettings


@dataclass
class Opening:
    """Waits for the writer, then for the ambient frame, then for the lamp. Whoever gives it up looks no further."""

    settings: SweepSettings
    phase: Phase = Phase.WAIT_WRITER
    over: bool = False
    """The lamp is warm: the stage may move."""
    deadline: Deadline = field(default_factory=Deadline)

    def start(self, now_ns: int) -> None:
        """The writer was told to make the file; nothing moves until it has."""
        self.deadline.at_ns = now_ns + self.settings.writer_start_ns

    def writer_ready(self, event: WriterReady, now_ns: int) -> list[Action]:
        """The file is there. A sweep that goes on has its ambient frame already."""
        said: list[Action] = [] if event.reserved else [Say("this file system cannot reserve space: watch the disk")]
        if self.settings.resume is not None or not self.settings.dark_frames:
            return said + self._warm_up(now_ns)
        self.phase = Phase.AMBIENT
        self.deadline.at_ns = now_ns + self.settings.exposure_ns + self.settings.frame_timeout_ns
        return [*said, SetLamp(on=False), Snap()]

    def ambient_came(self, now_ns: int) -> list[Action]:
        """The room's light is known (or its frame came damaged, and is done without): the lamp may be lit."""
        return self._warm_up(now_ns)

    def time_is_up(self, now_ns: int) -> list[Action]:
        """The ambient frame did not come, or the lamp is warm."""
        if self.phase is Phase.AMBIENT:
            return [Say("no ambient frame came: the camera does not answer"), *self._warm_up(now_ns)]
        self.over = True
        return []

    def _warm_up(self, now_ns: int) -> list[Action]:
        self.phase = Phase.WARM_UP
        self.deadline.at_ns = now_ns + round(self.settings.warm_up_ns * self.settings.time_scale)
        return [SetLamp(on=True)]
