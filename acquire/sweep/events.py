"""The events of a sweep, as values: from stage, camera, writer and operator."""

from __future__ import annotations

from dataclasses import dataclass

from acquire.cameras.protocol import CameraFrame, CameraGone
from acquire.contract.messaging.messages import AckItem, EndAck, Nack
from acquire.contract.states import Outcome
from acquire.stages.protocol import StageEvent


@dataclass(frozen=True)
class WriterReady:
    """A writer has opened the scan file."""

    reserved: bool
    """False where the file system cannot reserve the file's space."""
    came_back: bool
    """True for every writer of the scan but the first."""
    committed: tuple[AckItem, ...] = ()
    """Frames that the file contains already."""


@dataclass(frozen=True)
class Committed:
    """The writer acknowledged frames."""

    frames: tuple[AckItem, ...]
    durable_count: int
    """Frames of the scan that survive a power cut."""


@dataclass(frozen=True)
class Refused:
    """The writer refused a frame, or the scan."""

    nack: Nack

    @property
    def is_final(self) -> bool:
        """The writer will never take this frame: it is not sent again."""
        return self.nack.reason in ("immutable", "protocol") and self.nack.frame_index >= 0


@dataclass(frozen=True)
class Sealed:
    """The writer's answer to the end: the scan file is closed, or could not be."""

    end_ack: EndAck


@dataclass(frozen=True)
class PauseRequested:
    """Hold the sweep."""


@dataclass(frozen=True)
class ResumeRequested:
    """Continue a paused sweep."""


@dataclass(frozen=True)
class StopRequested:
    """End the sweep early; frames that were taken are kept."""

    outcome: Outcome = Outcome.STOPPED
    reason: str = "stopped by the operator"


@dataclass(frozen=True)
class Tick:
    """Time has passed."""

    no_alarm_ns: int | None = None
    """``StageStatus.no_alarm_ns``."""


LaneEvent = WriterReady | Committed | Refused | Sealed
SweepEvent = StageEvent | CameraFrame | CameraGone | LaneEvent | PauseRequested | ResumeRequested | StopRequested | Tick
