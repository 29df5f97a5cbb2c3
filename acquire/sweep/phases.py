"""The phases of a sweep and the one table of transitions between them; an illegal transition raises."""

from __future__ import annotations

from enum import Enum, auto
from typing import Final

from acquire.contract.states import IllegalTransitionError, State


class Phase(Enum):
    """What a sweep is doing."""

    WAIT_WRITER = auto()
    """The writer makes the scan file; nothing moves before it is there."""
    AMBIENT = auto()
    """One frame is taken with the lamp off."""
    WARM_UP = auto()
    OVERLAP = auto()
    """A resumed sweep takes its last frame again and compares it."""
    RUN = auto()
    """The stage runs a segment; frames are taken."""
    STOPPING = auto()
    """The stage was told to stop, or rests until the camera is back; what follows is decided when it rests."""
    REPEAT = auto()
    """Frame 0 is taken again for the drift check."""
    LIMIT = auto()
    """The stage touches its limit switch again to count lost steps."""
    DRAIN = auto()
    """The stage rests for good; frames that were taken are being committed."""
    SEAL = auto()
    """The end was sent; the writer closes the file."""
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
    """Stop of the operator, fault, or failed check."""
    DRAIN = auto()
    SEAL = auto()
    CLOSE = auto()
    """The writer has answered to the end."""
    ABANDON = auto()
    """The writer refused the file, or does not answer."""


BEFORE_MOTION: Final = frozenset({Phase.WAIT_WRITER, Phase.AMBIENT, Phase.WARM_UP})
STAGE_PHASES: Final = frozenset({Phase.OVERLAP, Phase.RUN, Phase.STOPPING, Phase.REPEAT, Phase.LIMIT})
"""The stage moves, or will when it gets credit."""
CHECK_PHASES: Final = frozenset({Phase.AMBIENT, Phase.OVERLAP, Phase.REPEAT})
"""Frames that are taken here are not frames of the sweep."""

_P, _D = Phase, Decision
_AFTER_MOTION = {
    _D.BEGIN_RUN: _P.RUN,
    _D.AWAIT_CAMERA: _P.STOPPING,
    _D.REPEAT_FIRST: _P.REPEAT,
    _D.CHECK_LIMIT: _P.LIMIT,
    _D.DRAIN: _P.DRAIN,
    _D.END_EARLY: _P.STOPPING,
}
TRANSITIONS: Final[dict[Phase, dict[Decision, Phase]]] = {
    _P.WAIT_WRITER: {
        _D.TAKE_AMBIENT: _P.AMBIENT,
        _D.LIGHT_LAMP: _P.WARM_UP,
        _D.END_EARLY: _P.STOPPING,
        _D.ABANDON: _P.DONE,
    },
    _P.AMBIENT: {_D.LIGHT_LAMP: _P.WARM_UP, _D.END_EARLY: _P.STOPPING},
    _P.WARM_UP: {
        _D.COMPARE_OVERLAP: _P.OVERLAP,
        _D.BEGIN_RUN: _P.RUN,
        _D.AWAIT_CAMERA: _P.STOPPING,
        _D.END_EARLY: _P.STOPPING,
    },
    _P.OVERLAP: _AFTER_MOTION,
    _P.RUN: _AFTER_MOTION | {_D.RETAKE: _P.STOPPING},
    _P.STOPPING: {decision: phase for decision, phase in _AFTER_MOTION.items() if decision is not _D.AWAIT_CAMERA},
    _P.REPEAT: {_D.CHECK_LIMIT: _P.LIMIT, _D.DRAIN: _P.DRAIN, _D.END_EARLY: _P.STOPPING},
    _P.LIMIT: {_D.DRAIN: _P.DRAIN, _D.END_EARLY: _P.STOPPING},
    _P.DRAIN: {_D.SEAL: _P.SEAL, _D.ABANDON: _P.DONE},
    _P.SEAL: {_D.CLOSE: _P.DONE, _D.ABANDON: _P.DONE},
    _P.DONE: {},
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


def rig_state(phase: Phase, *, holding: bool) -> State:
    """The rig's state that belongs to a phase."""
    if phase in BEFORE_MOTION:
        return State.ARMED
    if phase in STAGE_PHASES and phase is not Phase.LIMIT:
        return State.HOLDING if holding else State.SWEEPING
    return State.FINISHING
