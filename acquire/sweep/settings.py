"""Acquire/sweep/settings.py."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.plan import SweepPlan
from acquire.contract.units import ns_from_ms
from acquire.stages.protocol import Segment
from acquire.sweep.pairing import Spacing


@dataclass(frozen=True)
class OverlapLimits:
    """Differences up to which the rig counts as unmoved after an interruption."""

    stage_steps: float = 1.2
    """Microsteps; noise makes up a tenth of one."""
    specimen_px: float = 0.35
    """Pixels in the image; noise makes up a fiftieth of one."""
    brightness: float = 0.05
    """Relative change of the light."""


@dataclass(frozen=True)
class ResumeFrom:
    """What a sweep that goes on after an interruption needs of its past."""

    last_frame: int
    """The last frame of the committed prefix; it is taken again and compared."""
    stored: NDArray[Any]
    before: NDArray[Any] | None
    """The stored frame before it; None for frame 0."""
    first: NDArray[Any]
    """Frame 0, for the drift check at the end."""
    limits: OverlapLimits
    marks: dict[str, float] = field(default_factory=dict)
    """What was marked before the interruption, by its name among the sweep's checks."""


@dataclass(frozen=True)
class SweepSettings:
    """What a sweep needs to know beforehand."""

    scan_uid: str
    plan: SweepPlan
    format: FrameFormat
    run_up_steps: int
    period_ms: float
    """Least time between two triggers."""
    frame_timeout_ns: int
    max_attempts: int
    writer_start_ns: int
    seal_ns: int
    motion_ns: int
    """Longest wait for a move, for the next trigger that has credit, or for a stop."""
    camera_away_ns: int = 0
    """Longest wait for a camera that went away."""
    warm_up_ns: int = 0
    dark_frames: bool = True
    repeat_first: bool = True
    check_limit: bool = False
    needs_confirmation: bool = False
    """A frame is published only after the controller was heard to be without an alarm after its exposure."""
    time_scale: float = 1.0
    """Of simulated durations; time-outs stay as they are."""
    resume: ResumeFrom | None = None
    """None for a sweep that begins."""

    def segment(self, first: int, last: int) -> Segment:
        """The frames first..last as the stage runs them."""
        plan = self.plan
        return Segment(
            first_steps=plan.position_steps(first),
            pitch_steps=plan.pitch_steps,
            count=last - first + 1,
            mode=plan.mode,
            settle_ms=plan.settle_ms,
            dwell_ms=plan.exposure_ms,
            period_ms=self.period_ms,
            run_up_steps=self.run_up_steps,
        )

    @property
    def exposure_ns(self) -> int:
        """How long an exposure takes by the wall clock."""
        return ns_from_ms(self.plan.exposure_ms * self.time_scale)

    @property
    def spacing(self) -> Spacing:
        """How far a frame may be from its trigger: on the fly the next one is a period away, else a time-out."""
        if self.plan.mode == "step":
            return Spacing(apart_ns=self.frame_timeout_ns // 2)
        period_ns = ns_from_ms(self.period_ms * self.time_scale)
        early_ns = min(Spacing().early_ns, period_ns // 4)
        return Spacing(late_ns=period_ns * 3 // 4, early_ns=early_ns, apart_ns=ns_from_ms(self.period_ms / 4))
