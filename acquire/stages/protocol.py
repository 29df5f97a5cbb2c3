"""What every motion controller can do: move, and run segments of shots gated by an absolute credit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, Protocol

import msgspec


class Segment(msgspec.Struct, frozen=True):
    """Shots at equal distances that the controller takes by itself: shot j at first + j x pitch, j = 0..count-1."""

    first_steps: int
    """Position of shot 0 in microsteps."""
    pitch_steps: int
    """Signed microsteps between shots."""
    count: int
    """Number of shots, at least 1."""
    mode: Literal["step", "fly"] = "step"
    settle_ms: float = 0.0
    """Rest between a move's end and the trigger (step mode)."""
    dwell_ms: float = 0.0
    """Rest after the trigger before the stage may move again: the exposure and the camera's dead time."""
    period_ms: float = 0.0
    """Least time between two triggers; in fly mode it sets the speed."""
    run_up_steps: int = 0
    """Distance from which shot 0 is approached, on the side opposite to the direction of travel; less at a limit."""


class StageInfo(msgspec.Struct, frozen=True):
    """What the controller is and which counters it has."""

    kind: str
    version: str = ""
    boot_id: str = ""
    counts_triggers: bool = True
    """False: the driver cannot prove that a trigger was fired; the report says so."""
    counts_strobes: bool = False
    has_limit_switch: bool = False
    modes: tuple[str, ...] = ("step",)
    """Sweep modes that the controller can run."""


class Triggered(msgspec.Struct, frozen=True):
    """A trigger was fired."""

    trigger_id: int
    """Counter of the controller since its boot, 0-based, over all segments."""
    shot_index: int
    """j within the segment."""
    position_steps: int
    """Microsteps that the controller counted when it fired."""
    trigger_cycles: int = 0
    """64-bit time in controller cycles; 0 unknown."""
    at_mono_ns: int = 0
    """CLOCK_MONOTONIC of the host when it learned of it (or when it was fired, where that is known)."""
    position_um: float | None = None
    """Stage position at mid-exposure where the driver knows better than the microsteps; None otherwise."""
    fired_ns: int = 0
    """When it was fired by the controller's own clock, from wherever it counts; 0 unknown."""


class SegmentDone(msgspec.Struct, frozen=True):
    """All shots of the segment were fired and the stage rests."""

    position_steps: int


class Moved(msgspec.Struct, frozen=True):
    """A move, homing or zeroing ended and the stage rests."""

    position_steps: int
    position_trusted: bool
    zero_id: str = ""
    steps_lost: int | None = None
    """After touching the limit again: microsteps that were lost since homing."""


class Held(msgspec.Struct, frozen=True):
    """The stage holds within a segment, at a known place between two shots."""

    reason: Literal["requested", "no credit", "lease", "link lost"]
    """``lease``: it did not hear the host; ``link lost``: the host does not hear it. Both go on by themselves."""
    position_steps: int


class Stopped(msgspec.Struct, frozen=True):
    """Motion ended early; the segment or move is over."""

    position_steps: int
    position_trusted: bool
    reason: str = "requested"


class Alarm(msgspec.Struct, frozen=True):
    """The controller stopped by itself and stays stopped until it is cleared."""

    code: str
    """The row of the fault table (F12, F13, F15, F23 ...)."""
    detail: str
    position_steps: int
    position_trusted: bool


StageEvent = Triggered | SegmentDone | Moved | Held | Stopped | Alarm
StageSink = Callable[[StageEvent], None]


class StageStatus(msgspec.Struct, frozen=True):
    """Where the stage is now, as far as the host knows."""

    position_steps: int
    position_trusted: bool
    zero_id: str
    moving: bool
    triggers: int
    """Triggers fired since boot."""
    lamp_on: bool = False
    no_alarm_ns: int | None = None
    """CLOCK_MONOTONIC at which the controller is known to have been without an alarm; None where it cannot be known."""
    damaged_blocks: int = 0
    """Blocks that came damaged over the line since it was opened, and were asked for again."""


class Stage(Protocol):
    """A motion controller. No call blocks on motion: what happens comes to the sink, from any thread.

    One activity at a time: a second one while the first runs raises ``CommandRefusedError``.
    """

    def open(self, sink: StageSink) -> StageInfo:
        """Connect and shake hands; events go to ``sink`` from now on."""
        ...

    def close(self) -> None:
        """Stop motion and triggers, switch outputs to safe, disconnect; idempotent, never raises."""
        ...

    def status(self) -> StageStatus:
        """What the host knows now; does not ask the controller."""
        ...

    def move_to(self, position_steps: int, rate_steps_per_s: float = 0.0) -> None:
        """Start a move; ``Moved`` (or ``Stopped``, ``Alarm``) follows.

        ``rate_steps_per_s`` is not exceeded; 0, or more than the stage's highest: as fast as the stage goes.
        """
        ...

    def home(self) -> None:
        """Find the limit switch and make a new zero there; ``Moved`` with a new zero_id follows."""
        ...

    def zero_here(self) -> None:
        """Call the present position zero (no limit switch); ``Moved`` with a new zero_id follows."""
        ...

    def check_limit(self) -> None:
        """Touch the limit again and return; ``Moved`` with ``steps_lost`` (None without a switch) follows."""
        ...

    def begin_segment(self, segment: Segment, may_trigger_through: int) -> int:
        """Start a segment with its first credit; returns the trigger_id that shot 0 will have."""
        ...

    def grant(self, may_trigger_through: int) -> None:
        """Shots up to this shot_index of the running segment may be fired; absolute, never shrinks."""
        ...

    def hold(self) -> None:
        """Pause the segment between two shots; ``Held`` follows."""
        ...

    def resume(self) -> None:
        """Go on after a hold; the stage backs up and runs up again where it must."""
        ...

    def stop(self) -> None:
        """Decelerate and end the activity; ``Stopped`` follows. Safe at any time, also when idle (no event)."""
        ...

    def set_lamp(self, *, on: bool) -> None:
        """Switch the projector's lamp."""
        ...

    def keep_alive(self) -> None:
        """Renew the motion lease; called by the host's main loop after real progress."""
        ...
