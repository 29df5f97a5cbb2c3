"""The lockstep ledger: which camera frame belongs to which trigger. It never guesses; what is doubtful is lost.

Three counters must agree for every frame: steps commanded, triggers fired, frame ids of the camera. A frame that
cannot be proven to belong to its trigger is reported lost, and the sweep takes it again. Ids alone do not tell of a
trigger that the camera never saw: it counts nothing then, and all frames behind would move up by one. Only time tells.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace


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
    fired_ns: int = 0
    """When it was fired by the controller's own clock; 0 unknown."""
    expected_camera_id: int | None = None
    """None until the first frame after arming has shown where the camera's counter stands."""


@dataclass(frozen=True)
class Match:
    """What one arriving frame means."""

    shot: Shot | None
    """The trigger that it belongs to; None: nobody triggered it, or it came too late."""
    lost: tuple[Shot, ...] = ()
    """Triggers whose frames will not come any more."""
    doubtful: bool = False
    """The frame may have been that of the last of these."""


@dataclass(frozen=True)
class Spacing:
    """How far in time a frame may be from its trigger; 0: there is no such bound."""

    late_ns: int = 0
    """An exposure that began so long after its trigger (host's clock) belongs to a later one."""
    early_ns: int = 5_000_000
    """An exposure that began so long before its trigger (host's clock) was not made by it."""
    apart_ns: int = 0
    """Camera's clock minus controller's clock may differ so much between one pair and the next."""


@dataclass(frozen=True)
class _Times:
    """What a frame says of its time, and how far that may be from its trigger's."""

    exposure_start_ns: int
    camera_ns: int
    apart_ns: int


@dataclass
class Pairing:
    """Pairs triggers with frames between one arming of the camera and the next."""

    spacing: Spacing = Spacing()
    pending: deque[Shot] = field(default_factory=deque)
    armed_at_ns: int = 0
    _last_camera_id: int | None = None
    _on_host_clock: bool = False
    _offset_ns: int | None = None
    """Camera's clock minus controller's clock at the last pair since arming."""
    _likely_offset_ns: int | None = None
    """The same as the last frame had it that was, or may have been, a trigger's; arming does not forget it."""

    def arm(self, now_ns: int, spacing: Spacing | None = None) -> None:
        """The camera was armed anew: its counter and its clock may stand anywhere, older exposures are stale."""
        self.pending.clear()
        self._last_camera_id = self._offset_ns = None
        self.armed_at_ns = now_ns
        self.spacing = spacing or self.spacing

    @property
    def can_tell(self) -> bool:
        """Whether time tells which of several triggers a frame belongs to; until it does, only one may be awaited."""
        return self._on_host_clock or self._offset_ns is not None

    def note_clock(self, exposure_start_ns: int) -> None:
        """A frame of the camera says when it was exposed (host's clock; 0: it does not)."""
        self._on_host_clock |= exposure_start_ns > 0

    def triggered(self, shot: Shot) -> None:
        """A trigger was fired: its frame is awaited, with the next id of the camera."""
        expected = None if self._last_camera_id is None else self._last_camera_id + 1 + len(self.pending)
        self.pending.append(replace(shot, expected_camera_id=expected))

    def frame(
        self, camera_frame_id: int, exposure_start_ns: int, camera_ns: int = 0, *, apart_ns: int | None = None
    ) -> Match:
        """A frame arrived. Ids and times decide; one that is before its trigger, or repeated, belongs to nobody.

        Args:
            camera_frame_id: the camera's counter.
            exposure_start_ns: by the host's clock; 0 unknown.
            camera_ns: by the camera's own clock; 0 unknown.
            apart_ns: a closer bound than :attr:`Spacing.apart_ns` for a frame that came before the word of its trigger;
                None: it came after. Such a frame is taken only if the clocks differ as they did before: the first one
                proves nothing, its trigger is lost, and fired again.
        """
        early = apart_ns is not None
        apart_ns = self.spacing.apart_ns if apart_ns is None else min(apart_ns, self.spacing.apart_ns)
        self.note_clock(exposure_start_ns)
        if self._is_stale(camera_frame_id, exposure_start_ns):
            return Match(None)
        times = _Times(exposure_start_ns, camera_ns, apart_ns)
        lost = self._skip_to(camera_frame_id) + self._skip_unseen(camera_frame_id, times)
        self._last_camera_id = camera_frame_id
        if self.pending and early and not self._is_proven(times):
            lost += (self.pending.popleft(),)
            self._expect_anew()
            return Match(None, lost, doubtful=True)
        if not self.pending or not self._fits(self.pending[0], camera_frame_id, times):
            self._expect_anew()
            return Match(None, lost)
        shot = self.pending.popleft()
        if camera_ns and shot.fired_ns:
            self._offset_ns = self._likely_offset_ns = camera_ns - shot.fired_ns
        self._expect_anew()
        return Match(shot, lost)

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
        before_arming = 0 < exposure_start_ns < self.armed_at_ns - self.spacing.early_ns
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

    def _skip_unseen(self, camera_frame_id: int, times: _Times) -> tuple[Shot, ...]:
        """Triggers that the camera never saw: the frame is too late for them, and no id was used up."""
        lost = []
        while self.pending and self._is_too_late_for(self.pending[0], times):
            lost.append(self.pending.popleft())
        if lost:
            self._expect(camera_frame_id)
        return tuple(lost)

    def _is_too_late_for(self, shot: Shot, times: _Times) -> bool:
        late_ns, start_ns = self.spacing.late_ns, times.exposure_start_ns
        by_host = bool(late_ns and start_ns) and start_ns - shot.at_mono_ns >= late_ns
        return by_host or self._drift_ns(shot, times) > 0

    def _drift_ns(self, shot: Shot, times: _Times) -> int:
        """How much the two clocks say otherwise than at the last pair; 0: they agree, or nobody knows."""
        if not (times.apart_ns and times.camera_ns and shot.fired_ns) or self._offset_ns is None:
            return 0
        drift_ns = times.camera_ns - shot.fired_ns - self._offset_ns
        return drift_ns if abs(drift_ns) > times.apart_ns else 0

    def _is_proven(self, times: _Times) -> bool:
        """The clocks differ as they did at the frame before, be that from before arming: no chance makes it so."""
        if not (self.pending and times.camera_ns and self.pending[0].fired_ns):
            return False
        if self._offset_ns is not None:
            return True
        before, self._likely_offset_ns = self._likely_offset_ns, times.camera_ns - self.pending[0].fired_ns
        return before is not None and abs(self._likely_offset_ns - before) <= times.apart_ns

    def _fits(self, shot: Shot, camera_frame_id: int, times: _Times) -> bool:
        right_id, start_ns = shot.expected_camera_id in (None, camera_frame_id), times.exposure_start_ns
        after = start_ns == 0 or start_ns >= shot.at_mono_ns - self.spacing.early_ns
        return right_id and after and self._drift_ns(shot, times) == 0

    def _expect_anew(self) -> None:
        """The ids that the remaining triggers will have, now that the camera's counter is known."""
        assert self._last_camera_id is not None
        self._expect(self._last_camera_id + 1)

    def _expect(self, first_id: int) -> None:
        self.pending = deque(replace(shot, expected_camera_id=first_id + j) for j, shot in enumerate(self.pending))
