"""The plan of a sweep: frame k is taken at first + k x steps_per_frame (docs/design.md, section 3)."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

MAX_FRAMES = 100_000
MAX_POSITION_STEPS = 10_000_000

Position = Annotated[int, msgspec.Meta(ge=-MAX_POSITION_STEPS, le=MAX_POSITION_STEPS)]


class SweepPlan(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """First and last position, pitch and mode of one sweep; both ends are included."""

    first_steps: Position
    """Position of frame 0 in microsteps."""
    last_steps: Position
    """Position that the last frame does not pass, in microsteps; below ``first_steps`` sweeps the other way."""
    steps_per_frame: Annotated[int, msgspec.Meta(ge=1, le=100_000)]
    """Microsteps between two frames."""
    um_per_microstep: Annotated[float, msgspec.Meta(gt=0, le=1000)]
    """Travel of one microstep in um."""
    mode: Literal["step", "fly"] = "step"
    """``step`` stops for each frame; ``fly`` triggers at constant speed."""
    settle_ms: Annotated[float, msgspec.Meta(ge=0, le=60_000)] = 0.0
    """Rest between the end of a move and the trigger, in ms (step mode)."""
    exposure_ms: Annotated[float, msgspec.Meta(gt=0, le=60_000)] = 10.0
    """Exposure of each frame in ms."""

    @property
    def count(self) -> int:
        """Number of frames n = floor(|last - first| / steps_per_frame) + 1."""
        return abs(self.last_steps - self.first_steps) // self.steps_per_frame + 1

    @property
    def direction(self) -> int:
        """+1 when positions grow during the sweep, else -1."""
        return 1 if self.last_steps >= self.first_steps else -1

    @property
    def pitch_steps(self) -> int:
        """Signed microsteps from one frame to the next."""
        return self.direction * self.steps_per_frame

    def position_steps(self, frame_index: int) -> int:
        """Position of frame ``frame_index`` in microsteps."""
        return self.first_steps + frame_index * self.pitch_steps

    def positions_um(self) -> NDArray[np.float64]:
        """Positions of all frames in um, shape [n], float64."""
        steps = self.first_steps + np.arange(self.count, dtype=np.float64) * self.pitch_steps
        return steps * np.float64(self.um_per_microstep)
