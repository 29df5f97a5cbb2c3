"""Protocol of camera drivers: armed for hardware triggers, each frame is delivered to a sink with its id."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import msgspec
from numpy.typing import NDArray

from acquire.contract.errors import SweepscopeError
from acquire.contract.messaging.messages import FrameFormat


class CameraLostError(SweepscopeError):
    """The camera does not answer; its driver reconnects and reports it (:class:`CameraGone`)."""


class CameraSettings(msgspec.Struct, frozen=True):
    """Settings that can be changed during preview and are locked during a sweep."""

    exposure_ms: float
    gain: float
    brightness_percent: float


class CameraInfo(msgspec.Struct, frozen=True):
    """Identity of the camera, and the counters it has."""

    kind: str
    format: FrameFormat
    counts_frames: bool = True
    """False: ids are made up by the driver; a lost frame is only noticed by its absence."""
    limits: dict[str, tuple[float, float]] = {}
    """[lowest, highest] of each of :class:`CameraSettings` by name; what is not named here has no known limit."""


@dataclass(frozen=True)
class CameraFrame:
    """One frame as the camera delivered it. The receiver owns the pixels; the driver does not reuse them."""

    pixels: NDArray[Any]
    """[h, w] or [h, w, 3] RGB; uint8, or uint16 right-aligned."""
    camera_frame_id: int
    """The camera's own counter."""
    exposure_start_ns: int
    """CLOCK_MONOTONIC of the host, 0 unknown."""
    camera_ns: int = 0
    """The camera's own clock at the exposure, from wherever it counts; 0: it has none."""


@dataclass(frozen=True)
class CameraGone:
    """The camera stopped delivering (unplugged, restarted), or is back; frame ids then start again."""

    detail: str
    back: bool = False
    """True when it has come back and is armed again."""


CameraSink = Callable[[CameraFrame | CameraGone], None]


class Camera(Protocol):
    """A camera. Frames come to the sink from the driver's thread, in the order of exposure."""

    def open(self, sink: CameraSink) -> CameraInfo:
        """Connect; frames go to ``sink`` from now on."""
        ...

    def close(self) -> None:
        """Disarm and disconnect; idempotent, never raises."""
        ...

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings; returns what the camera really uses (limits, rounding)."""
        ...

    def arm(self) -> None:
        """Deliver one frame for each hardware trigger from now on; stale frames are dropped before."""
        ...

    def disarm(self) -> None:
        """Ignore triggers from now on; idempotent."""
        ...

    def snap(self) -> None:
        """Take one frame now by software (preview, dark frame); it comes to the sink like any other."""
        ...


class HostFiredCamera(Camera, Protocol):
    """A camera without a trigger input: the host tells it of each shot, once the stage stands still."""

    def fire(self, at_ns: int, position_steps: int) -> None:
        """A shot at ``position_steps`` (microsteps) at ``at_ns`` (CLOCK_MONOTONIC); its frame began after it."""
        ...
