"""The lockstep ledger: which camera frame belongs to which trigger. It never guesses; what is doubtful is lost.

Three counters must agree for every frame: steps commanded, triggers fired, frame ids of the camera. A frame that
cannot be proven to belong to its trigger is reported lost, and the sweep takes it again.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Shot:
    """One trigger that was fired and whose frame is awaited."""

    frame_index: int
    attempt: int
    trigger_id: int
    position_steps: int
    position_um: float
    trigger_cycles: int
    at_mono_ns: int
    deadline_ns: int
    expected_camera_id: int | None
    """None until the first frame after arming has shown where the camera's counter stands."""


@dataclass(frozen=True)
class Pairing:
    """What one arriving frame means."""

    shot: Shot | None
    """The trigger that it belongs to; None: nobody triggered it, or it came too late."""
    lost: tuple[Shot, ...] = ()
    """Triggers whose frames will not come any more."""


@dataclass
class Ledger:
    """Pairs triggers with frames between one arming of the camera and the next."""

    tolerance_ns: int = 5_000_000
    """An exposure that began so long before its trigger was not made by it."""
    pending: deque[Shot] = field(default_factory=deque)
    armed_at_ns: int = 0
    extra_frames: int = 0
    """Frames that belong to no trigger, dropped and counted."""
    _last_camera_id: int | None = None

    def arm(self, now_ns: int) -> None:
        """The camera was armed anew: its counter may stand anywhere, older exposures are stale."""
        self.pending.clear()
        self._last_camera_id = None
        self.armed_at_ns = now_ns

    def triggered(
        self,
        *,
        frame_index: int,
        attempt: int,
        trigger_id: int,
        position_steps: int,
        position_um: float,
        trigger_cycles: int,
        at_mono_ns: int,
        deadline_ns: int,
    ) -> None:
        """A trigger was fired at ``position_steps`` (microsteps)."""
        expected = None if self._last_camera_id is None else self._last_camera_id + 1 + len(self.pending)
        self.pending.append(
            Shot(
                frame_index,
                attempt,
                trigger_id,
                position_steps,
                position_um,
                trigger_cycles,
                at_mono_ns,
                deadline_ns,
                expected,
            )
        )

    def frame(self, camera_frame_id: int, exposure_start_ns: int) -> Pairing:
        """A frame arrived. Ids decide; an exposure before its trigger, or a repeated id, belongs to nobody."""
        if self._is_stale(camera_frame_id, exposure_start_ns):
            self.extra_frames += 1
            return Pairing(None)
        lost = self._skip_to(camera_frame_id)
        self._last_camera_id = camera_frame_id
        if not self.pending or not self._fits(self.pending[0], camera_frame_id, exposure_start_ns):
            self.extra_frames += 1
            self._expect_anew()
            return Pairing(None, lost)
        shot = self.pending.popleft()
        self._expect_anew()
        return Pairing(shot, lost)

    def overdue(self, now_ns: int) -> tuple[Shot, ...]:
        """Triggers whose deadline has passed; they are lost, and no longer waited for."""
        late = []
        while self.pending and self.pending[0].deadline_ns <= now_ns:
            late.append(self.pending.popleft())
        return tuple(late)

    def drop_all(self) -> tuple[Shot, ...]:
        """Give up all pending triggers (the camera went away); they are returned as lost."""
        lost = tuple(self.pending)
        self.pending.clear()
        return lost

    def _is_stale(self, camera_frame_id: int, exposure_start_ns: int) -> bool:
        seen_before = self._last_camera_id is not None and camera_frame_id <= self._last_camera_id
        before_arming = 0 < exposure_start_ns < self.armed_at_ns - self.tolerance_ns
        return seen_before or before_arming

    def _skip_to(self, camera_frame_id: int) -> tuple[Shot, ...]:
        """Triggers whose ids the camera has passed over."""
        lost = []
        while self.pending:
            expected = self.pending[0].expected_camera_id
            if expected is None or expected >= camera_frame_id:
                break
            lost.append(self.pending.popleft())
        return tuple(lost)

    def _fits(self, shot: Shot, camera_frame_id: int, exposure_start_ns: int) -> bool:
        right_id = shot.expected_camera_id in (None, camera_frame_id)
        return right_id and (exposure_start_ns == 0 or exposure_start_ns >= shot.at_mono_ns - self.tolerance_ns)

    def _expect_anew(self) -> None:
        """The ids that the remaining triggers will have, now that the camera's counter is known."""
        assert self._last_camera_id is not None
        for place, shot in enumerate(self.pending):
            if shot.expected_camera_id is None:
                known = {**shot.__dict__, "expected_camera_id": self._last_camera_id + 1 + place}
                self.pending[place] = Shot(**known)
