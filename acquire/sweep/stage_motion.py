"""The course of the stage between opening and closing: run after run until each frame is taken, then the checks.

It promises that nothing is begun while the stage moves, that what is not taken is gone for again until it is or the
sweep ends early, and that whatever the stage is waited for has a deadline.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec

from acquire.contract.states import Outcome

from .actions import Action, CheckLimit, Disarm, RaiseFault, Say, StopStage
from .finish import Closing
from .phases import Deadline, Phase
from .progress import Shooting
from .self_checks import Checks


@dataclass
class Course:
    """Says what the stage does next, and when it is done."""

    shooting: Shooting
    checks: Checks
    closing: Closing
    phase: Phase | None = None
    """None before the stage may move, and when it has come to rest for good."""
    paused: bool = False
    away: bool = False
    """The camera is gone; the course goes on by itself when it is back."""
    deadline: Deadline = field(default_factory=Deadline)
    """By when the stage must have answered."""
    _camera_deadline: Deadline = field(default_factory=Deadline)
    """By when the camera must be back."""
    _resting: bool = True
    _skip_checks: bool = False

    def __post_init__(self) -> None:
        self.settings = self.shooting.settings

    def begin(self, now_ns: int) -> list[Action]:
        """The first motion; a sweep that goes on takes its last frame again and compares it."""
        resume = self.settings.resume
        if resume is None:
            return self._next_run(now_ns)
        self._move(Phase.OVERLAP, now_ns)
        return self.shooting.begin(resume.last_frame, resume.last_frame, now_ns, gated=False)

    def look_around(self, now_ns: int) -> list[Action]:
        """What follows from the state of things, whichever event brought it about."""
        if not self._resting or self.shooting.ledger.pending or self.phase is None:
            return []
        follows = {
            Phase.OVERLAP: self._after_overlap,
            Phase.RUN: self._after_run,
            Phase.STOPPING: self._after_stop,
            Phase.REPEAT: self._check_limit,
        }.get(self.phase)
        return follows(now_ns) if follows is not None else []

    def rest(self, steps_lost: int | None, now_ns: int) -> list[Action]:
        """The stage stands; ``steps_lost`` is what it found when it touched the limit, None where it did not."""
        self.halt()
        self.deadline.at_ns = None
        if self.phase is not Phase.LIMIT:
            return []
        self.checks.count_lost_steps(steps_lost)
        return self._come_to_rest(now_ns)

    def halt(self) -> None:
        """The stage stands, or is not waited for any more: what it still hears, it shall do."""
        self._resting = self.shooting.segment_done = True

    def camera_gone(self, now_ns: int) -> list[Action]:
        """Nothing is triggered for a camera that is not there."""
        if not self.away:
            self.away, self._camera_deadline.at_ns = True, now_ns + self.settings.camera_away_ns
        return self.stop_run(now_ns) if self.phase is Phase.RUN else []

    def camera_is_missed(self, now_ns: int) -> bool:
        """True once, when a sweep that waits for its camera has waited long enough."""
        waits = self.away and self.phase in (Phase.RUN, Phase.STOPPING) and not self.closing.is_decided
        return waits and self._camera_deadline.passed(now_ns)

    def go_on(self, now_ns: int) -> list[Action]:
        """Raise the stage's credit as far as the window allows."""
        if self.phase is not Phase.RUN or self.paused:
            return []
        actions = self.shooting.grant()
        self.expect_stage(now_ns)
        return actions

    def end_early(self, outcome: Outcome, reason: str, now_ns: int) -> list[Action]:
        """What was taken is kept, what is missing stays so. The first who says so is right."""
        if self.closing.is_decided:
            return []
        self.paused = self.shooting.short_of_credit = False
        if self.phase in (Phase.REPEAT, Phase.LIMIT) and outcome is Outcome.STOPPED:
            self._skip_checks = True  # all frames are there: only the checks end early
        else:
            self.closing.decide(outcome, reason)
        return self.stop_run(now_ns)

    def stop_run(self, now_ns: int) -> list[Action]:
        """Frames that are on their way are still taken; what follows is decided when the stage rests."""
        if self._resting:
            self.phase = Phase.STOPPING
            return []
        self._move(Phase.STOPPING, now_ns)
        return [StopStage()]

    def expect_stage(self, now_ns: int) -> None:
        """The stage must answer by the deadline only while it has something to do."""
        waiting = self.shooting.awaits_trigger() and not self.paused
        self.deadline.at_ns = now_ns + self.settings.motion_ns if waiting else None

    def _next_run(self, now_ns: int) -> list[Action]:
        """Take what nobody has yet, from the first gap on; so are lost frames taken again."""
        run = self.shooting.next_run()
        if run is None:
            return self._repeat_first(now_ns)
        if self.away:
            self.phase = Phase.STOPPING  # it rests already; what is missing is taken when the camera is back
            return []
        self._move(Phase.RUN, now_ns)
        return self.shooting.begin(*run, now_ns)

    def _after_run(self, now_ns: int) -> list[Action]:
        return [] if self.paused else self._next_run(now_ns)

    def _after_overlap(self, now_ns: int) -> list[Action]:
        complaint = self.checks.complaint
        if not complaint:
            return [Say("the rig is where it was: the sweep goes on"), *self._next_run(now_ns)]
        told = msgspec.structs.replace(
            self.shooting.fault("F01"),
            happened=f"the scan cannot go on: {complaint} (overlap.png beside the scan shows it)",
            to_do="put it back, or home the stage, and resume; or close the scan: 'sweepscope recover --seal'",
        )
        return [RaiseFault(told), *self.end_early(Outcome.INTERRUPTED, f"overlap check: {complaint}", now_ns)]

    def _repeat_first(self, now_ns: int) -> list[Action]:
        if self._skip_checks or self.away or not self.settings.repeat_first or not self.checks.has_first:
            return self._check_limit(now_ns)
        self._move(Phase.REPEAT, now_ns)
        return self.shooting.begin(0, 0, now_ns, gated=False)

    def _check_limit(self, now_ns: int) -> list[Action]:
        if self._skip_checks or not self.settings.check_limit:
            return [Disarm(), *self._come_to_rest(now_ns)]
        self._move(Phase.LIMIT, now_ns)
        return [Disarm(), CheckLimit()]

    def _after_stop(self, now_ns: int) -> list[Action]:
        if self.closing.is_decided:
            return [Disarm(), *self._come_to_rest(now_ns)]
        return self._after_run(now_ns)

    def _come_to_rest(self, now_ns: int) -> list[Action]:
        self.phase = None
        return self.closing.drain(now_ns)

    def _move(self, phase: Phase, now_ns: int) -> None:
        self.phase, self._resting = phase, False
        self.deadline.at_ns = now_ns + self.settings.motion_ns
