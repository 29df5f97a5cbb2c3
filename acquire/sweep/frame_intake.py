"""Triggers and frames as they come in: of each trigger is known that its frame was taken, or why it was not.

A frame is taken at most once: the ledger gives each to one trigger, and the book of shots names each frame that is
taken, so that no later segment includes it. Whatever else comes is counted by name: extra, damaged, lost, doubtful.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from acquire.cameras.protocol import CameraFrame, what_is_wrong
from acquire.contract.messaging.messages import Role
from acquire.stages.protocol import Triggered

from .actions import Publish
from .confirmation import Unproven
from .frame_messages import image_of_shot, image_of_snap
from .pairing import Shot
from .progress import Shooting

COUNTERS: tuple[str, ...] = (
    "triggered",
    "received",
    "extra",
    "damaged",
    "lost",
    "doubtful",
    "check_triggers",
    "check_frames",
)


_EARLY_NS = 150_000_000
"""A controller is asked for its triggers every 20 ms; a block that was lost on the line comes some 100 ms later."""
_EARLY_APART_NS = 5_000_000
"""A frame that came before the word of its trigger must fit it in time as well as that."""


@dataclass(frozen=True)
class Loss:
    """Triggers whose frames are not to be had."""

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
    """Nobody triggered it, or it came too late."""


@dataclass
class Intake:
    """Everything that the camera and the trigger wire bring goes through here."""

    shooting: Shooting
    counters: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTERS, 0))
    _early: list[tuple[CameraFrame, int]] = field(default_factory=list)
    """Frames that came before the word of any trigger, and when they came."""
    _just_proven: bool = False
    """Frames were sent on their way by the last tick: the window may not know them yet."""
    _deaf: bool = False
    """The controller has failed: no frame that comes now can be trusted."""

    def __post_init__(self) -> None:
        self._unproven = Unproven(self.shooting.settings.needs_proof)

    @property
    def nothing_waits(self) -> bool:
        """True when every frame that was taken is where the window knows of it."""
        return not self._unproven and not self._just_proven

    def triggered(self, event: Triggered, now_ns: int, *, check: bool) -> str:
        """Book a trigger; returns what is wrong with it in words, empty when all is well."""
        self.counters["check_triggers" if check else "triggered"] += 1
        return self.shooting.triggered(event, now_ns)

    def count_frame(self, *, check: bool) -> None:
        """Something came from the camera."""
        self.counters["check_frames" if check else "received"] += 1

    def is_early(self, event: CameraFrame, now_ns: int) -> bool:
        """Keep a frame that may have overtaken the word of its trigger, until that comes: a controller is asked for it.

        Only where the camera's own clock will tell whether it is that trigger's.
        """
        shooting = self.shooting
        if event.exposure_start_ns or not event.camera_ns or shooting.segment_done or shooting.ledger.pending:
            return False
        self._early.append((event, now_ns))
        return True

    def early(self, now_ns: int) -> Iterator[CameraFrame]:
        """Frames that waited, as long as a trigger waits for one; the others go on waiting for theirs."""
        self._expire_early(now_ns)
        while self._early and self.shooting.ledger.pending:
            yield self._early.pop(0)[0]

    def _expire_early(self, now_ns: int) -> None:
        """Frames that waited too long, or from before the camera was armed, are nobody's."""
        since_ns = max(now_ns - _EARLY_NS, self.shooting.ledger.armed_at_ns)
        waiting = [(event, came_ns) for event, came_ns in self._early if came_ns > since_ns]
        self.counters["extra"] += len(self._early) - len(waiting)
        self._early = waiting

    def pair(self, event: CameraFrame, *, was_early: bool = False) -> Arrival:
        """Whose frame this is, and which triggers will not get theirs any more."""
        if self._deaf:
            return Arrival()
        apart_ns = _EARLY_APART_NS if was_early else None
        pairing = self.shooting.ledger.frame(
            event.camera_frame_id, event.exposure_start_ns, event.camera_ns, apart_ns=apart_ns
        )
        losses = (Loss(pairing.lost, "F16", "its frame did not come"),) if pairing.lost else ()
        if pairing.unproven:
            self.counters["doubtful"] += 1
            return Arrival(None, losses)
        if pairing.shot is None:
            self.counters["extra"] += 1
            return Arrival(None, losses, extra=True)
        wrong = what_is_wrong(event, self.shooting.settings.format)
        if wrong:
            self.counters["damaged"] += 1
            return Arrival(None, (*losses, Loss((pairing.shot,), "F19", wrong)))
        return Arrival(pairing.shot, losses)

    def take(self, event: CameraFrame, shot: Shot, role: Role = "sweep") -> list[Publish]:
        """Take a frame for good: on its way at once, or when the controller has been heard after the exposure."""
        if role == "sweep":
            self.shooting.paired.add(shot.frame_index)
        publish = Publish(image_of_shot(event, shot, self.shooting.settings, role), event.pixels)
        began_ns = event.exposure_start_ns or shot.at_mono_ns
        return self._unproven.add(publish, began_ns + self.shooting.settings.exposure_ns)

    def take_ambient(self, event: CameraFrame, position_steps: int) -> list[Publish]:
        """A frame that no trigger asked for, taken at ``position_steps`` (microsteps); none if it came damaged."""
        self.shooting.ledger.note_clock(event.exposure_start_ns)
        if what_is_wrong(event, self.shooting.settings.format):
            self.counters["damaged"] += 1
            return []
        return [Publish(image_of_snap(event, "ambient", position_steps, self.shooting.settings), event.pixels)]

    def proven(self, sound_ns: int | None) -> list[Publish]:
        """Frames that may go on their way: the controller was sound at ``sound_ns``, after their exposure."""
        found = self._unproven.proven(sound_ns)
        self._just_proven = bool(found)
        return found

    def overdue(self, now_ns: int) -> Loss | None:
        """Triggers whose frames are waited for no longer."""
        self._expire_early(now_ns)
        late = self.shooting.ledger.overdue(now_ns)
        return Loss(late, "F16", "its frame did not come in time") if late else None

    def camera_gone(self, detail: str) -> Loss:
        """All triggers whose frames the camera took with it."""
        self.counters["extra"] += len(self._early)
        self._early.clear()
        return Loss(self.shooting.ledger.drop_all(), "F18", detail)

    def count_lost(self, shot: Shot) -> int:
        """A trigger's frame is lost; returns how many attempts at it have been."""
        self.counters["lost"] += 1
        attempts = self.shooting.attempts
        attempts[shot.frame_index] = attempts.get(shot.frame_index, 0) + 1
        return attempts[shot.frame_index]

    def distrust(self) -> None:
        """The controller stopped by itself: what was not proven before may show it: it is taken again, or missing."""
        for frame_index in self._unproven.drop():
            self.counters["doubtful"] += 1
            self.shooting.paired.discard(frame_index)
        self.counters["doubtful"] += len(self.shooting.ledger.drop_all())
        self._deaf = True
