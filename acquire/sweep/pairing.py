"""Pairing of camera frames with triggers, by ids and times. It never guesses: a doubtful frame counts as lost.

Three counters must agree for every frame: steps commanded, triggers fired, frame ids of the camera. Ids alone do not
show a trigger that the camera missed: it used up no id, and every later frame would be paired with the trigger before
its own. Only times show that.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from acquire.cameras.protocol import CameraFrame

EARLY_DRIFT_NS = 5_000_000
"""Bound of :attr:`Tolerances.drift_ns` for a frame that arrived before the report of its trigger."""


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
    """CLOCK_MONOTONIC of the trigger."""
    deadline_ns: int
    fired_ns: int = 0
    """Time of the trigger by the controller's own clock; 0 unknown."""
    expected_camera_id: int | None = None
    """None until the first frame after arming has shown the camera's counter."""


@dataclass(frozen=True)
class Match:
    """What one arriving frame means."""

    shot: Shot | None
    """The trigger that it belongs to; None: it belongs to none, or arrived too late."""
    lost: tuple[Shot, ...] = ()
    """Triggers whose frames will not arrive any more."""
    doubtful: bool = False
    """The frame may belong to the last of the lost triggers; nothing proves it."""


@dataclass(frozen=True)
class Tolerances:
    """How far in time a frame may be from its trigger; 0: no bound."""

    late_ns: int = 0
    """An exposure that began so long after a trigger (host's clock) belongs to a later one."""
    early_ns: int = 5_000_000
    """An exposure that began so long before a trigger (host's clock) does not belong to it."""
    drift_ns: int = 0
    """Change of (camera's clock - controller's clock) from one pair to the next."""


@dataclass
class Pairing:
    """Pairs triggers with frames from one arming of the camera to the next."""

    tolerances: Tolerances = Tolerances()
    pending: deque[Shot] = field(default_factory=deque)
    """Triggers whose frames are awaited."""
    armed_at_ns: int = 0
    _last_camera_id: int | None = None
    _on_host_clock: bool = False
    _offset_ns: int | None = None
    """Camera's clock minus controller's clock at the last pair since arming."""
    _last_offset_ns: int | None = None
    """The same at the last frame that belonged, or may have belonged, to a trigger; arming does not reset it."""

    def arm(self, now_ns: int, tolerances: Tolerances | None = None) -> None:
        """The camera was armed: its counter and clock may have been reset, older exposures are stale."""
        self.pending.clear()
        self._last_camera_id = self._offset_ns = None
        self.armed_at_ns = now_ns
        self.tolerances = tolerances or self.tolerances

    @property
    def has_times(self) -> bool:
        """Times show which of several triggers a frame belongs to; without them only one trigger may be pending."""
        return self._on_host_clock or self._offset_ns is not None

    def note_clock(self, frame: CameraFrame) -> None:
        """Note whether the camera's frames have exposure times of the host's clock."""
        self._on_host_clock |= frame.exposure_start_ns > 0

    def triggered(self, shot: Shot) -> None:
        """A trigger was fired: its frame is awaited, with the camera's next id."""
        expected = None if self._last_camera_id is None else self._last_camera_id + 1 + len(self.pending)
        self.pending.append(replace(shot, expected_camera_id=expected))

    def match(self, frame: CameraFrame, *, was_early: bool = False) -> Match:
        """Find the trigger of a frame; a frame that precedes its trigger, or is a repetition, belongs to none.

        Args:
            frame: the frame that arrived.
            was_early: it arrived before the report of its trigger. Then it is taken only if the two clocks differ as
                they did before; the first such frame proves nothing: its trigger is lost, and fired again.
        """
        self.note_clock(frame)
        if self._is_stale(frame):
            return Match(None)
        bound_ns = min(EARLY_DRIFT_NS, self.tolerances.drift_ns) if was_early else self.tolerances.drift_ns
        frame_id = frame.camera_frame_id
        lost = self._drop_while(lambda shot: shot.expected_camera_id is not None and shot.expected_camera_id < frame_id)
        missed = self._drop_while(lambda shot: self._is_too_late(frame, shot, bound_ns))
        if missed:
            self._expect_from(frame_id)
        match = self._match_first(frame, lost + missed, bound_ns, was_early=was_early)
        self._last_camera_id = frame_id
        self._expect_from(frame_id + 1)
        return match

    def overdue(self, now_ns: int) -> tuple[Shot, ...]:
        """Triggers whose deadline has passed; they are lost."""
        return self._drop_while(lambda shot: shot.deadline_ns <= now_ns)

    def drop_all(self) -> tuple[Shot, ...]:
        """Give up all pending triggers, for example because the camera is gone; they are lost."""
        return self._drop_while(lambda _shot: True)

    def _match_first(self, frame: CameraFrame, lost: tuple[Shot, ...], bound_ns: int, *, was_early: bool) -> Match:
        if not self.pending:
            return Match(None, lost)
        first = self.pending[0]
        if was_early and not self._is_proven(frame, first, bound_ns):
            return Match(None, (*lost, self.pending.popleft()), doubtful=True)
        if not self._fits(frame, first, bound_ns):
            return Match(None, lost)
        if frame.camera_ns and first.fired_ns:
            self._offset_ns = self._last_offset_ns = frame.camera_ns - first.fired_ns
        return Match(self.pending.popleft(), lost)

    def _is_stale(self, frame: CameraFrame) -> bool:
        repeated = self._last_camera_id is not None and frame.camera_frame_id <= self._last_camera_id
        return repeated or 0 < frame.exposure_start_ns < self.armed_at_ns - self.tolerances.early_ns

    def _is_too_late(self, frame: CameraFrame, shot: Shot, bound_ns: int) -> bool:
        late_ns, start_ns = self.tolerances.late_ns, frame.exposure_start_ns
        by_host = bool(late_ns and start_ns) and start_ns - shot.at_mono_ns >= late_ns
        return by_host or self._drift_ns(frame, shot, bound_ns) > 0

    def _fits(self, frame: CameraFrame, shot: Shot, bound_ns: int) -> bool:
        right_id, start_ns = shot.expected_camera_id in (None, frame.camera_frame_id), frame.exposure_start_ns
        after_trigger = start_ns == 0 or start_ns >= shot.at_mono_ns - self.tolerances.early_ns
        return right_id and after_trigger and self._drift_ns(frame, shot, bound_ns) == 0

    def _drift_ns(self, frame: CameraFrame, shot: Shot, bound_ns: int) -> int:
        """Change of the two clocks' difference since the last pair; 0: within the bound, or unknown."""
        if not (bound_ns and frame.camera_ns and shot.fired_ns) or self._offset_ns is None:
            return 0
        drift_ns = frame.camera_ns - shot.fired_ns - self._offset_ns
        return drift_ns if abs(drift_ns) > bound_ns else 0

    def _is_proven(self, frame: CameraFrame, shot: Shot, bound_ns: int) -> bool:
        """The clocks differ as they did at an earlier frame, also one from before arming: that is no coincidence."""
        if not (frame.camera_ns and shot.fired_ns):
            return False
        if self._offset_ns is not None:
            return True
        before, self._last_offset_ns = self._last_offset_ns, frame.camera_ns - shot.fired_ns
        return before is not None and abs(self._last_offset_ns - before) <= bound_ns

    def _drop_while(self, condition: Callable[[Shot], bool]) -> tuple[Shot, ...]:
        """Remove the first pending triggers as long as the condition holds for them; returns them."""
        dropped = []
        while self.pending and condition(self.pending[0]):
            dropped.append(self.pending.popleft())
        return tuple(dropped)

    def _expect_from(self, first_id: int) -> None:
        self.pending = deque(replace(shot, expected_camera_id=first_id + j) for j, shot in enumerate(self.pending))
