"""The phases of a sweep and the one table of transitions between them; an illegal transition raises."""

from __future__ import annotations

from enum import Enum, auto
from typing import Final

from acquire.contract.states import IllegalTransitionError


class Phase(Enum):
    """What a sweep is doing."""

    WAIT_WRITER = auto()
    """The writer creates the scan file; nothing moves before it exists."""
    AMBIENT = auto()
    """One frame is taken with the lamp off."""
    WARM_UP = auto()
    OVERLAP = auto()
    """A resumed sweep takes its last frame again and compares it."""
    RUN = auto()
    """The stage runs a segment; frames are taken."""
    STOPPING = auto()
    """The stage was told to stop, or rests until the camera is back; when it rests, the next decision is made."""
    REPEAT = auto()
    """Frame 0 is taken again for the drift check."""
    LIMIT = auto()
    """The stage touches its limit switch again to count lost steps."""
    DRAIN = auto()
    """The stage rests for good; frames that were taken are being committed."""
    SEAL = auto()
    """The end message was sent; the writer closes the file."""
    DONE = auto()


class Decision(Enum):
    """Why a sweep goes from one phase to the next."""

    TAKE_AMBIENT = auto()
    LIGHT_LAMP = auto()
    COMPARE_OVERLAP = auto()
    BEGIN_RUN = auto()
    """The first run, a retake, or the next frames that are missing."""
    RETAKE = auto()
    """A frame was lost: the run is stopped, the next one takes it again."""
    AWAIT_CAMERA = auto()
    REPEAT_FIRST = auto()
    CHECK_LIMIT = auto()
    END_EARLY = auto()
    """Stop by the operator, fault, or failed check."""
    DRAIN = auto()
    SEAL = auto()
    CLOSE = auto()
    """The writer has answered the end message."""
    ABANDON = auto()
    """The writer refused the file, or does not answer."""


BEFORE_MOTION: Final = frozenset({Phase.WAIT_WRITER, Phase.AMBIENT, Phase.WARM_UP})
SHOOTING: Final = frozenset({Phase.OVERLAP, Phase.RUN, Phase.STOPPING, Phase.REPEAT})
"""The stage takes frames, or will when it gets credit."""
STAGE_PHASES: Final = SHOOTING | {Phase.LIMIT}
"""The stage moves, or will."""
CHECK_PHASES: Final = frozenset({Phase.AMBIENT, Phase.OVERLAP, Phase.REPEAT})
"""Frames that are taken here are not frames of the sweep."""

P, D = Phase, Decision
_AFTER_MOTION = {
    D.BEGIN_RUN: P.RUN,
    D.AWAIT_CAMERA: P.STOPPING,
    D.REPEAT_FIRST: P.REPEAT,
    D.CHECK_LIMIT: P.LIMIT,
    D.DRAIN: P.DRAIN,
    D.END_EARLY: P.STOPPING,
}
TRANSITIONS: Final[dict[Phase, dict[Decision, Phase]]] = {
    P.WAIT_WRITER: {D.TAKE_AMBIENT: P.AMBIENT, D.LIGHT_LAMP: P.WARM_UP, D.END_EARLY: P.STOPPING, D.ABANDON: P.DONE},
    P.AMBIENT: {D.LIGHT_LAMP: P.WARM_UP, D.END_EARLY: P.STOPPING},
    P.WARM_UP: {
        D.COMPARE_OVERLAP: P.OVERLAP,
        D.BEGIN_RUN: P.RUN,
        D.AWAIT_CAMERA: P.STOPPING,
        D.END_EARLY: P.STOPPING,
    },
    P.OVERLAP: _AFTER_MOTION,
    P.RUN: _AFTER_MOTION | {D.RETAKE: P.STOPPING},
    P.STOPPING: {decision: phase for decision, phase in _AFTER_MOTION.items() if decision is not D.AWAIT_CAMERA},
    P.REPEAT: {D.CHECK_LIMIT: P.LIMIT, D.DRAIN: P.DRAIN, D.END_EARLY: P.STOPPING},
    P.LIMIT: {D.DRAIN: P.DRAIN, D.END_EARLY: P.STOPPING},
    P.DRAIN: {D.SEAL: P.SEAL, D.ABANDON: P.DONE},
    P.SEAL: {D.CLOSE: P.DONE, D.ABANDON: P.DONE},
    P.DONE: {},
}


def next_phase(phase: Phase, decision: Decision) -> Phase:
    """The phase that ``decision`` leads to from ``phase``.

    Raises:
        IllegalTransitionError: the table has no such transition: a bug.
    """
    try:
        return TRANSITIONS[phase][decision]
    except KeyError:
        raise IllegalTransitionError(f"sweep: {decision.name} in {phase.name}") from None
