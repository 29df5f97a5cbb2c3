"""What can happen to a sweep, as values: from the writer, the camera and the operator."""

from __future__ import annotations

from dataclasses import dataclass

from acquire.cameras.protocol import CameraFrame, CameraGone
from acquire.contract.messaging.messages import AckItem, EndAck, Nack
from acquire.contract.states import Outcome
from acquire.stages.protocol import StageEvent


@dataclass(frozen=True)
class WriterReady:
    """A writer has the scan's file open (again)."""

    reserved: bool
    """False where the file system cannot reserve the file's space."""
    came_back: bool
    """True for every writer of the scan but the first."""
    committed: tuple[AckItem, ...] = ()
    """Frames that its file holds already."""


@dataclass(frozen=True)
class Committed:
    """Frames became committed; ``durable_count`` frames survive a power cut."""

    frames: tuple[AckItem, ...]
    durable_count: int


@dataclass(frozen=True)
class Refused:
    """The writer refused a frame, or the scan, and says why."""

    nack: Nack

    @property
    def is_final(self) -> bool:
        """The writer will never take this frame; sending it again would change nothing."""
        return self.nack.reason in ("immutable", "protocol") and self.nack.frame_index >= 0


@dataclass(frozen=True)
class Sealed:
    """The scan's file is closed for good (or could not be)."""

    end_ack: EndAck


LaneEvent = WriterReady | Committed | Refused | Sealed


@dataclass(frozen=True)
class PauseRequested:
    """The operator wants the sweep to hold."""


@dataclass(frozen=True)
class ResumeRequested:
    """The operator wants the sweep to go on."""


@dataclass(frozen=True)
class StopRequested:
    """The sweep shall end early; what was taken is kept."""

    outcome: Outcome = Outcome.STOPPED
    reason: str = "stopped by the operator"


@dataclass(frozen=True)
class Tick:
    """Time has passed."""

    no_alarm_ns: int | None = None
    """``StageStatus.no_alarm_ns``."""


SweepEvent = StageEvent | CameraFrame | CameraGone | LaneEvent | PauseRequested | ResumeRequested | StopRequested | Tick
