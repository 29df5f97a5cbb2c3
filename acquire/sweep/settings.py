"""What a sweep must know before it begins."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.plan import SweepPlan
from acquire.contract.units import ns_from_ms
from acquire.stages.protocol import Segment
from acquire.sweep.pairing import Tolerances


@dataclass(frozen=True)
class OverlapLimits:
    """Differences up to which the rig counts as unmoved after an interruption."""

    stage_steps: float = 1.2
    """Microsteps; noise alone gives a tenth of one."""
    specimen_px: float = 0.35
    """Pixels in the image; noise alone gives a fiftieth of one."""
    brightness: float = 0.05
    """Relative change of the light."""


@dataclass(frozen=True)
class ResumeFrom:
    """What a resumed sweep needs of its first part."""

    last_frame: int
    """The last frame of the committed prefix; it is taken again and compared."""
    stored: NDArray[Any]
    """The pixels of that frame in the file."""
    before: NDArray[Any] | None
    """The stored frame before it; None for frame 0."""
    first: NDArray[Any]
    """Frame 0, for the drift check at the end."""
    limits: OverlapLimits
    marks: dict[str, float] = field(default_factory=dict)
    """Figures that were saved before the interruption, by their names in the end message."""


@dataclass(frozen=True)
class SweepSettings:
    """Plan, checks and time-outs of one sweep. Time-outs are not scaled by ``time_scale``."""

    scan_uid: str
    plan: SweepPlan
    format: FrameFormat
    run_up_steps: int
    period_ms: float
    """Least time between two triggers."""
    frame_timeout_ns: int
    """From the end of the exposure to the frame."""
    max_attempts: int
    """A frame that is lost so often ends the sweep."""
    writer_start_ns: int
    """Longest wait for the writer to create the file."""
    seal_ns: int
    """Longest wait for the last commits, and for the sealed file."""
    motion_ns: int
    """Longest wait for a move, for the next trigger that has credit, or for a stop."""
    camera_away_ns: int = 0
    """Longest wait for a camera that went away."""
    warm_up_ns: int = 0
    dark_frames: bool = True
    """Take an ambient frame with the lamp off before the sweep."""
    repeat_first: bool = True
    """Take frame 0 again after the sweep and measure the drift."""
    check_limit: bool = False
    """Touch the limit switch after the sweep and count lost steps."""
    needs_confirmation: bool = False
    """Publish a frame only after the controller reported no alarm since its exposure."""
    time_scale: float = 1.0
    """Of simulated durations."""
    resume: ResumeFrom | None = None
    """None for a new sweep."""

    def segment(self, first: int, last: int) -> Segment:
        """The frames first..last as a segment of the stage."""
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
        """Duration of an exposure by the wall clock."""
        return ns_from_ms(self.plan.exposure_ms * self.time_scale)

    @property
    def tolerances(self) -> Tolerances:
        """How far a frame may be from its trigger: on the fly the next trigger is a period away, else a time-out."""
        if self.plan.mode == "step":
            return Tolerances(drift_ns=self.frame_timeout_ns // 2)
        period_ns = ns_from_ms(self.period_ms * self.time_scale)
        early_ns = min(Tolerances().early_ns, period_ns // 4)
        return Tolerances(late_ns=period_ns * 3 // 4, early_ns=early_ns, drift_ns=ns_from_ms(self.period_ms / 4))
