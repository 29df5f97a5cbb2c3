"""The actions of a sweep, as values: the daemon carries them out in order, and only the daemon touches devices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from acquire.contract.messaging.messages import End, FaultReport, Image
from acquire.stages.protocol import Segment


class Action:
    """One of the actions below."""


@dataclass(frozen=True)
class SetLamp(Action):
    """Switch the lamp."""

    on: bool


@dataclass(frozen=True)
class Arm(Action):
    """Arm the camera for hardware triggers; frames from before are dropped."""


@dataclass(frozen=True)
class Disarm(Action):
    """Let the camera ignore triggers."""


@dataclass(frozen=True)
class Snap(Action):
    """Take one frame by software trigger."""


@dataclass(frozen=True)
class BeginSegment(Action):
    """Start a segment with its first credit."""

    segment: Segment
    may_trigger_through: int
    """The last shot of the segment that may be fired; -1: none yet."""


@dataclass(frozen=True)
class Grant(Action):
    """Raise the credit of the running segment."""

    may_trigger_through: int
    """The last shot of the segment that may be fired."""


@dataclass(frozen=True)
class HoldStage(Action):
    """Pause the segment."""


@dataclass(frozen=True)
class ResumeStage(Action):
    """Continue the segment."""


@dataclass(frozen=True)
class StopStage(Action):
    """End the segment or move."""


@dataclass(frozen=True)
class CheckLimit(Action):
    """Touch the limit switch again."""


@dataclass(frozen=True)
class Publish(Action):
    """Send a frame to the writer and to the live lane."""

    image: Image
    pixels: Any


@dataclass(frozen=True)
class SavePicture(Action):
    """Save a picture in the scan's folder."""

    name: str
    picture: Any
    """uint8 [h, w, 3] RGB."""


@dataclass(frozen=True)
class SaveMarks(Action):
    """Save measured figures in the scan's folder at once: they are known even if no end is ever sent."""

    measured: dict[str, float]


@dataclass(frozen=True)
class SendEnd(Action):
    """Tell writer and worker that no more frames follow."""

    end: End


@dataclass(frozen=True)
class RaiseFault(Action):
    """Show a fault to the operator."""

    fault: FaultReport


@dataclass(frozen=True)
class Say(Action):
    """Show a line to the operator."""

    text: str
