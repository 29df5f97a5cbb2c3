"""The phases of a sweep in their order, the state of the rig that each one is, and a wait that ends."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

from acquire.contract.states import State


class Phase(Enum):
    """Where in its course a sweep is."""

    WAIT_WRITER = auto()
    AMBIENT = auto()
    WARM_UP = auto()
    OVERLAP = auto()
    """The last frame before an interruption is taken again and compared."""
    RUN = auto()
    STOPPING = auto()
    """The segment was told to stop; what follows is decided when the stage rests."""
    REPEAT = auto()
    LIMIT = auto()
    DRAIN = auto()
    """Frames that were taken are being committed."""
    SEAL = auto()
    DONE = auto()


OPENING: Final = (Phase.WAIT_WRITER, Phase.AMBIENT, Phase.WARM_UP)
SHOOTING: Final = (Phase.OVERLAP, Phase.RUN, Phase.STOPPING, Phase.REPEAT)
CHECKING: Final = (Phase.AMBIENT, Phase.OVERLAP, Phase.REPEAT)
"""What is taken here is compared with a frame of the sweep, and is none of it."""


def rig_state(phase: Phase, *, holding: bool) -> State:
    """The rig's state that belongs to a phase."""
    if phase in OPENING:
        return State.ARMED
    if phase in SHOOTING:
        return State.HOLDING if holding else State.SWEEPING
    return State.FINISHING


@dataclass
class Deadline:
    """How long something is waited for, in ns of the caller's clock; None while nothing is."""

    at_ns: int | None = None

    def passed(self, now_ns: int) -> bool:
        """True once, when the time has come."""
        if self.at_ns is None or now_ns < self.at_ns:
            return False
        self.at_ns = None
        return True
