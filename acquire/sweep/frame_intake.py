"""Frame intake: each camera frame is paired with its trigger, checked, and published once; or it is counted by name.

What cannot be published is extra (no trigger), damaged (another shape or type), lost, or doubtful. Lost, damaged and
doubtful frames are taken again (:mod:`acquire.sweep.retakes`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from acquire.cameras.protocol import CameraFrame
from acquire.contract.messaging.messages import FrameFormat, Image, Role
from acquire.contract.scan_data.checksums import frame_crc32
from acquire.contract.units import steps_to_um
from acquire.stages.protocol import Triggered

from .actions import Publish
from .credit_window import CreditWindow
from .pairing import Pairing, Shot
from .settings import SweepSettings

COUNTERS = ("triggered", "received", "extra", "damaged", "doubtful", "check_triggers", "check_frames")

_EARLY_NS = 150_000_000
"""A controller is asked for its triggers every 20 ms; a block that was lost on the line comes some 100 ms later."""
_EARLY_APART_NS = 5_000_000
"""A frame that came before the report of its trigger must fit it in time as well as that."""


@dataclass(frozen=True)
class Loss:
    """Triggers whose frames will not be had."""

    shots: tuple[Shot, ...]
    code: str
    """The fault that it is, if it happens too often."""
    detail: str


@dataclass(frozen=True)
class Arrival:
    """What one frame that arrived means."""

    shot: Shot | None = None
    """The trigger that it belongs to; None: it is not to be taken."""
    losses: tuple[Loss, ...] = ()
    extra: bool = False
    """Nothing triggered it, or it came too late."""


@dataclass
class Confirmation:
    """Frames that wait until the controller confirms that it did not stop during their exposure.

    An emergency stop or a restart of the controller puts the lamp out. The dark frame of that moment arrives before the
    alarm; committed, it could not be taken again. So a frame is published only after the controller was heard to be
    without an alarm after the end of its exposure. The credit window bounds how many frames can wait.
    """

    waiting: deque[tuple[int, Publish]] = field(default_factory=deque)
    """Frames in order, each with the end of its exposure (CLOCK_MONOTONIC, ns)."""

    def confirmed(self, no_alarm_ns: int | None) -> list[Publish]:
        """Take out the frames whose exposure had ended at ``no_alarm_ns``; None: nothing is known of the controller."""
        found = []
        while self.waiting and no_alarm_ns is not None and self.waiting[0][0] <= no_alarm_ns:
            found.append(self.waiting.popleft()[1])
        return found

    def drop(self) -> list[int]:
        """Give all up; returns the frame indices of those of the sweep."""
        images = [publish.image for _, publish in self.waiting]
        self.waiting.clear()
        return [image.frame_index for image in images if image.role == "sweep"]


@dataclass
class FrameIntake:
    """Everything that the camera and the trigger reports bring goes through here."""

    settings: SweepSettings
    window: CreditWindow
    """Learns of each frame that is published."""
    counters: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTERS, 0))
    pairing: Pairing = field(default_factory=Pairing)
    _early: list[tuple[CameraFrame, int]] = field(default_factory=list)
    """Frames that came before the report of any trigger, and when they came."""
    _failed: bool = False
    """The controller has failed: no frame that comes now can be trusted."""

    def __post_init__(self) -> None:
        self._exposure_ns = self.settings.exposure_ns
        self._confirmation = Confirmation()

    @property
    def is_settled(self) -> bool:
        """True when every frame that was taken is committed, or refused for good."""
        return not self._confirmation.waiting and not self.window.unacked

    # ---- triggers ----

    def arm(self, now_ns: int) -> None:
        """The camera is armed for a new segment: no frame from before belongs to it."""
        self.pairing.arm(now_ns, self.settings.spacing)

    @property
    def ahead(self) -> int | None:
        """Triggers that may be fired before the next frame arrives; None: any number.

        One at a time in step mode, and on the fly until time tells which frame is whose (a camera without a clock:
        always).
        """
        if self.settings.plan.mode == "fly" and self.pairing.can_tell:
            return None
        return 0 if self.pairing.pending else 1

    def triggered(self, event: Triggered, frame_index: int, attempt: int, now_ns: int) -> None:
        """A trigger was fired for ``frame_index``: its frame is awaited from now on."""
        um = steps_to_um(event.position_steps, self.settings.plan.um_per_microstep)
        shot = Shot(
            frame_index=frame_index,
            attempt=attempt,
            trigger_id=event.trigger_id,
            position_steps=event.position_steps,
            position_um=um if event.position_um is None else event.position_um,
            trigger_cycles=event.trigger_cycles,
            at_mono_ns=event.at_mono_ns or now_ns,
            deadline_ns=now_ns + self._exposure_ns + self.settings.frame_timeout_ns,
            fired_ns=event.fired_ns,
        )
        self.pairing.triggered(shot)

    # ---- frames ----

    def keep_early(self, frame: CameraFrame, now_ns: int) -> bool:
        """Keep a frame that may have overtaken the report of its trigger until that comes; False if it cannot have.

        Only where the camera's own clock will tell whether it is that trigger's.
        """
        if frame.exposure_start_ns or not frame.camera_ns or self.pairing.pending:
            return False
        self._early.append((frame, now_ns))
        return True

    def early(self, now_ns: int) -> Iterator[CameraFrame]:
        """Early frames, as long as a trigger waits for one; the others stay for triggers to come."""
        self._expire_early(now_ns)
        while self._early and self.pairing.pending:
            yield self._early.pop(0)[0]

    def pair(self, frame: CameraFrame, *, was_early: bool = False) -> Arrival:
        """Which trigger the frame belongs to, and which triggers will not get theirs any more."""
        if self._failed:
            return Arrival()
        apart_ns = _EARLY_APART_NS if was_early else None
        match = self.pairing.frame(frame.camera_frame_id, frame.exposure_start_ns, frame.camera_ns, apart_ns=apart_ns)
        losses = (Loss(match.lost, "F16", "its frame did not come"),) if match.lost else ()
        if match.doubtful:
            self.counters["doubtful"] += 1
            return Arrival(None, losses)
        if match.shot is None:
            self.counters["extra"] += 1
            return Arrival(None, losses, extra=True)
        wrong = self.settings.format.mismatch(frame.pixels)
        if wrong:
            self.counters["damaged"] += 1
            return Arrival(None, (*losses, Loss((match.shot,), "F19", wrong)))
        return Arrival(match.shot, losses)

    def take(self, frame: CameraFrame, shot: Shot, role: Role) -> list[Publish]:
        """Publish a frame: at once, or when the controller was heard after the exposure (then the list is empty)."""
        image = Image(
            scan_uid=self.settings.scan_uid,
            frame_index=shot.frame_index,
            role=role,
            attempt=shot.attempt,
            trigger_id=shot.trigger_id,
            camera_frame_id=frame.camera_frame_id,
            position_steps=shot.position_steps,
            position_um=shot.position_um,
            trigger_cycles=shot.trigger_cycles,
            exposure_start_ns=frame.exposure_start_ns,
            **_pixel_fields(frame, self.settings.format),
        )
        publish = Publish(image, frame.pixels)
        if not self.settings.needs_confirmation:
            return self._publish([publish])
        exposed_until_ns = (frame.exposure_start_ns or shot.at_mono_ns) + self._exposure_ns
        self._confirmation.waiting.append((exposed_until_ns, publish))
        return []

    def take_ambient(self, frame: CameraFrame, position_steps: int) -> list[Publish]:
        """Publish a frame without a trigger, taken at ``position_steps`` (microsteps); none if it came damaged."""
        settings = self.settings
        self.pairing.note_clock(frame.exposure_start_ns)
        if settings.format.mismatch(frame.pixels):
            self.counters["damaged"] += 1
            return []
        image = Image(
            scan_uid=settings.scan_uid,
            frame_index=0,
            role="ambient",
            camera_frame_id=frame.camera_frame_id,
            position_steps=position_steps,
            position_um=steps_to_um(position_steps, settings.plan.um_per_microstep),
            exposure_start_ns=frame.exposure_start_ns,
            **_pixel_fields(frame, settings.format),
        )
        return self._publish([Publish(image, frame.pixels)])

    def confirm(self, no_alarm_ns: int | None) -> list[Publish]:
        """The controller was without an alarm at ``no_alarm_ns`` (CLOCK_MONOTONIC): publish what was exposed."""
        return self._publish(self._confirmation.confirmed(no_alarm_ns))

    def _publish(self, frames: list[Publish]) -> list[Publish]:
        for frame in frames:
            self.window.publish(frame.image)
        return frames

    # ---- losses ----

    def overdue(self, now_ns: int) -> Loss | None:
        """Triggers whose frames did not come in time; None when there are none."""
        self._expire_early(now_ns)
        late = self.pairing.overdue(now_ns)
        return Loss(late, "F16", "its frame did not come in time") if late else None

    def camera_gone(self, detail: str) -> Loss:
        """All triggers whose frames the camera took with it."""
        self.counters["extra"] += len(self._early)
        self._early.clear()
        return Loss(self.pairing.drop_all(), "F18", detail)

    def fail(self) -> list[int]:
        """The controller stopped by itself: frames that are not confirmed may show it, and are given up.

        Returns:
            the frame indices that are not taken any more.
        """
        dropped = self._confirmation.drop()
        self.counters["doubtful"] += len(dropped) + len(self.pairing.drop_all())
        self._failed = True
        return dropped

    def _expire_early(self, now_ns: int) -> None:
        """Frames that waited too long, or from before the camera was armed, are extra."""
        since_ns = max(now_ns - _EARLY_NS, self.pairing.armed_at_ns)
        waiting = [(frame, came_ns) for frame, came_ns in self._early if came_ns > since_ns]
        self.counters["extra"] += len(self._early) - len(waiting)
        self._early = waiting


def _pixel_fields(frame: CameraFrame, frame_format: FrameFormat) -> dict[str, Any]:
    return {
        "shape": list(frame_format.shape),
        "dtype": frame_format.dtype,
        "bit_depth": frame_format.bit_depth,
        "pixel_format": frame_format.pixel_format,
        "crc32": frame_crc32(frame.pixels),
    }
