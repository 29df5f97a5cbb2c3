"""Frame intake: each camera frame is paired with its trigger, checked, and published once; or it is counted by name.

What cannot be published is extra (no trigger), damaged (another shape or type), lost, or doubtful. Lost and damaged
frames are taken again (:mod:`acquire.sweep.retakes`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from acquire.cameras.protocol import CameraFrame
from acquire.contract.messaging.messages import Image, Role
from acquire.contract.scan_data.checksums import frame_crc32
from acquire.contract.units import steps_to_um
from acquire.stages.protocol import Triggered

from .actions import Publish
from .credit_window import CreditWindow
from .pairing import Pairing, Shot
from .settings import SweepSettings

COUNTERS = ("triggered", "received", "extra", "damaged", "doubtful", "check_triggers", "check_frames")
_EARLY_NS = 150_000_000
"""Triggers are polled every 20 ms; one whose report was lost on the serial line is reported some 100 ms later."""


@dataclass(frozen=True)
class Loss:
    """Triggers whose frames will not arrive."""

    shots: tuple[Shot, ...]
    code: str
    """The fault that it becomes if it happens too often."""
    detail: str


@dataclass(frozen=True)
class Arrival:
    """What one frame that arrived means."""

    shot: Shot | None = None
    """The trigger that it belongs to; None: it is not taken."""
    losses: tuple[Loss, ...] = ()
    extra: bool = False
    """It belongs to no trigger, or arrived too late."""


@dataclass
class Confirmation:
    """Frames that wait until the controller confirms that it did not stop during their exposure.

    An emergency stop or a restart of the controller puts the lamp out. The dark frame of that moment arrives before the
    alarm; committed, it could not be taken again. So a frame is published only after the controller reported no alarm
    since the end of its exposure. The credit window bounds how many frames can wait.
    """

    waiting: deque[tuple[int, Publish]] = field(default_factory=deque)
    """Frames in order, each with the end of its exposure (CLOCK_MONOTONIC, ns)."""

    def confirmed(self, no_alarm_ns: int | None) -> list[Publish]:
        """Remove and return the frames whose exposure had ended at ``no_alarm_ns``; None: nothing is known."""
        found = []
        while self.waiting and no_alarm_ns is not None and self.waiting[0][0] <= no_alarm_ns:
            found.append(self.waiting.popleft()[1])
        return found

    def drop(self) -> list[int]:
        """Drop all frames; returns the indices of those of the sweep."""
        images = [publish.image for _, publish in self.waiting]
        self.waiting.clear()
        return [image.frame_index for image in images if image.role == "sweep"]


@dataclass
class FrameIntake:
    """Takes triggers and frames."""

    settings: SweepSettings
    window: CreditWindow
    """Is told of each frame that is published."""
    counters: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTERS, 0))
    pairing: Pairing = field(default_factory=Pairing)
    _confirmation: Confirmation = field(default_factory=Confirmation)
    _early: list[tuple[CameraFrame, int]] = field(default_factory=list)
    """Frames that arrived before the report of any trigger, and when they arrived."""
    _failed: bool = False
    """The controller has failed: no frame that arrives now can be trusted."""

    def __post_init__(self) -> None:
        self._exposure_ns = self.settings.exposure_ns

    @property
    def is_settled(self) -> bool:
        """Every frame that was taken is committed, or refused for good."""
        return not self._confirmation.waiting and not self.window.unacked

    # ---- triggers ----

    def arm(self, now_ns: int) -> None:
        """The camera is armed for a new segment: no frame from before belongs to it."""
        self.pairing.arm(now_ns, self.settings.tolerances)

    @property
    def ahead(self) -> int | None:
        """Triggers that may be fired before the next frame arrives; None: any number.

        One at a time in step mode, and on the fly as long as there are no times to pair by.
        """
        if self.settings.plan.mode == "fly" and self.pairing.has_times:
            return None
        return 0 if self.pairing.pending else 1

    def triggered(self, event: Triggered, frame_index: int, attempt: int, now_ns: int) -> None:
        """A trigger was fired for ``frame_index``: its frame is awaited."""
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
        """Keep a frame that may have arrived before the report of its trigger; False if it cannot have.

        Only the camera's own clock can tell later whether it belongs to that trigger.
        """
        if frame.exposure_start_ns or not frame.camera_ns or self.pairing.pending:
            return False
        self._early.append((frame, now_ns))
        return True

    def early(self, now_ns: int) -> Iterator[CameraFrame]:
        """Early frames, as long as a trigger is pending; the others wait for later triggers."""
        self._expire_early(now_ns)
        while self._early and self.pairing.pending:
            yield self._early.pop(0)[0]

    def pair(self, frame: CameraFrame, *, was_early: bool = False) -> Arrival:
        """Find the trigger of a frame, and the triggers whose frames will not arrive any more."""
        if self._failed:
            return Arrival()
        match = self.pairing.match(frame, was_early=was_early)
        losses = (Loss(match.lost, "F16", "its frame did not arrive"),) if match.lost else ()
        if match.shot is None:
            self.counters["doubtful" if match.doubtful else "extra"] += 1
            return Arrival(None, losses, extra=not match.doubtful)
        mismatch = self.settings.format.mismatch(frame.pixels)
        if mismatch:
            self.counters["damaged"] += 1
            return Arrival(None, (*losses, Loss((match.shot,), "F19", mismatch)))
        return Arrival(match.shot, losses)

    def take(self, frame: CameraFrame, shot: Shot, role: Role) -> list[Publish]:
        """Publish a frame; an empty list where it must be confirmed first."""
        fields = {"attempt": shot.attempt, "trigger_id": shot.trigger_id, "trigger_cycles": shot.trigger_cycles}
        publish = self._message(frame, role, shot.frame_index, shot.position_steps, shot.position_um, **fields)
        if not self.settings.needs_confirmation:
            return self._publish([publish])
        exposed_until_ns = (frame.exposure_start_ns or shot.at_mono_ns) + self._exposure_ns
        self._confirmation.waiting.append((exposed_until_ns, publish))
        return []

    def take_ambient(self, frame: CameraFrame, position_steps: int) -> list[Publish]:
        """Publish a frame without a trigger, taken at ``position_steps`` (microsteps); none if it arrived damaged."""
        self.pairing.note_clock(frame)
        if self.settings.format.mismatch(frame.pixels):
            self.counters["damaged"] += 1
            return []
        position_um = steps_to_um(position_steps, self.settings.plan.um_per_microstep)
        return self._publish([self._message(frame, "ambient", 0, position_steps, position_um)])

    def confirm(self, no_alarm_ns: int | None) -> list[Publish]:
        """The controller had no alarm at ``no_alarm_ns`` (CLOCK_MONOTONIC): publish what was exposed by then."""
        return self._publish(self._confirmation.confirmed(no_alarm_ns))

    def _message(
        self, frame: CameraFrame, role: Role, frame_index: int, steps: int, um: float, **fields: Any
    ) -> Publish:
        form = self.settings.format
        image = Image(
            scan_uid=self.settings.scan_uid,
            frame_index=frame_index,
            role=role,
            camera_frame_id=frame.camera_frame_id,
            position_steps=steps,
            position_um=um,
            exposure_start_ns=frame.exposure_start_ns,
            shape=list(form.shape),
            dtype=form.dtype,
            bit_depth=form.bit_depth,
            pixel_format=form.pixel_format,
            crc32=frame_crc32(frame.pixels),
            **fields,
        )
        return Publish(image, frame.pixels)

    def _publish(self, frames: list[Publish]) -> list[Publish]:
        for frame in frames:
            self.window.publish(frame.image)
        return frames

    # ---- losses ----

    def overdue(self, now_ns: int) -> Loss | None:
        """Triggers whose frames did not arrive in time; None when there are none."""
        self._expire_early(now_ns)
        late = self.pairing.overdue(now_ns)
        return Loss(late, "F16", "its frame did not arrive in time") if late else None

    def camera_gone(self, detail: str) -> Loss:
        """The camera is gone, and with it the frames of all pending triggers."""
        self.counters["extra"] += len(self._early)
        self._early.clear()
        return Loss(self.pairing.drop_all(), "F18", detail)

    def fail(self) -> list[int]:
        """The controller failed: drop what it did not confirm; returns the indices of those frames."""
        dropped = self._confirmation.drop()
        self.counters["doubtful"] += len(dropped) + len(self.pairing.drop_all())
        self._failed = True
        return dropped

    def _expire_early(self, now_ns: int) -> None:
        """Early frames that waited too long, or from before the camera was armed, are extra."""
        since_ns = max(now_ns - _EARLY_NS, self.pairing.armed_at_ns)
        waiting = [(frame, came_ns) for frame, came_ns in self._early if came_ns > since_ns]
        self.counters["extra"] += len(self._early) - len(waiting)
        self._early = waiting
