"""What a sweep wants done, as values: the daemon carries them out in order, and only the daemon touches devices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from acquire.contract.messaging.messages import End, FaultReport, Image
from acquire.stages.protocol import Segment


@dataclass(frozen=True)
class SetLamp:
    """Switch the lamp."""

    on: bool


@dataclass(frozen=True)
class Arm:
    """Arm the camera for hardware triggers; stale frames are dropped."""


@dataclass(frozen=True)
class Disarm:
    """Let the camera ignore triggers."""


@dataclass(frozen=True)
class Snap:
    """Take one frame by software."""


@dataclass(frozen=True)
class BeginSegment:
    """Start a segment of shots with its first credit."""

    segment: Segment
    may_trigger_through: int


@dataclass(frozen=True)
class Grant:
    """Raise the absolute credit of the running segment."""

    may_trigger_through: int


@dataclass(frozen=True)
class HoldStage:
    """Pause the segment."""


@dataclass(frozen=True)
class ResumeStage:
    """Go on with the segment."""


@dataclass(frozen=True)
class StopStage:
    """End the segment or move."""


@dataclass(frozen=True)
class CheckLimit:
    """Touch the limit switch again."""


@dataclass(frozen=True)
class Publish:
    """A frame goes onto the lossless and the live lane."""

    image: Image
    pixels: Any


@dataclass(frozen=True)
class SavePicture:
    """Lay a picture beside the scan."""

    name: str
    picture: Any
    """uint8 [h, w, 3] RGB."""


@dataclass(frozen=True)
class SaveMarks:
    """Lay beside the scan, at once, what must be known of it even if its end is never said."""

    measured: dict[str, float]


@dataclass(frozen=True)
class SendEnd:
    """Tell writer and worker that no more frames follow."""

    end: End


@dataclass(frozen=True)
class RaiseFault:
    """Show a fault to the operator."""

    fault: FaultReport


@dataclass(frozen=True)
class Say:
    """Show a line to the operator."""

    text: str


Action = (
    SetLamp
    | Arm
    | Disarm
    | Snap
    | BeginSegment
    | Grant
    | HoldStage
    | ResumeStage
    | StopStage
    | CheckLimit
    | Publish
    | SavePicture
    | SaveMarks
    | SendEnd
    | RaiseFault
    | Say
)
