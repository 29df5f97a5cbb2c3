"""The table of rig states, of their signs, and of the transitions between them; an illegal transition raises."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class State(StrEnum):
    """What the rig is doing."""

    DISCONNECTED = "disconnected"
    IDLE = "idle"
    HOMING = "homing"
    MOVING = "moving"
    PREVIEW = "preview"
    ARMED = "armed"
    SWEEPING = "sweeping"
    HOLDING = "holding"
    FINISHING = "finishing"
    FAULT = "fault"


RUNNING_STATES = frozenset({State.ARMED, State.SWEEPING, State.HOLDING, State.FINISHING})
"""States in which a scan is under way."""


class Sign(NamedTuple):
    """How a state looks on every screen; a word always stands beside it, so that nothing rests on font or colour."""

    glyph: str
    ascii_glyph: str


SIGNS: dict[str, Sign] = {
    State.DISCONNECTED: Sign("○", "o"),
    State.IDLE: Sign("●", "*"),
    State.HOMING: Sign("⌂", "H"),
    State.MOVING: Sign("↔", "M"),
    State.PREVIEW: Sign("◉", "P"),
    State.ARMED: Sign("◆", "A"),
    State.SWEEPING: Sign("▶", ">"),
    State.HOLDING: Sign("‖", "="),
    State.FINISHING: Sign("◢", "F"),
    State.FAULT: Sign("✖", "X"),
}
UNKNOWN_SIGN = Sign("?", "?")


def sign_of(state: str) -> Sign:
    """The sign of a state; that of the unknown for a state of a newer daemon."""
    return SIGNS.get(state, UNKNOWN_SIGN)


class HoldReason(StrEnum):
    """Why a sweep holds."""

    PAUSED = "paused"
    NO_CREDIT = "no credit"
    LINK_LOST = "link lost"
    CAMERA_AWAY = "camera away"


class Outcome(StrEnum):
    """How a scan ended; ``running`` only while it does, ``interrupted`` when a process died."""

    RUNNING = "running"
    COMPLETE = "complete"
    STOPPED = "stopped"
    ABORTED = "aborted"
    FAILED = "failed"
    INTERRUPTED = "interrupted"


SEALED_OUTCOMES = frozenset({Outcome.COMPLETE, Outcome.STOPPED, Outcome.ABORTED, Outcome.FAILED})

_S = State
TRANSITIONS: dict[State, frozenset[State]] = {
    _S.DISCONNECTED: frozenset({_S.IDLE, _S.FAULT}),
    _S.IDLE: frozenset({_S.DISCONNECTED, _S.HOMING, _S.MOVING, _S.PREVIEW, _S.ARMED, _S.FAULT}),
    _S.HOMING: frozenset({_S.DISCONNECTED, _S.IDLE, _S.FAULT}),
    _S.MOVING: frozenset({_S.DISCONNECTED, _S.IDLE, _S.PREVIEW, _S.FAULT}),
    _S.PREVIEW: frozenset({_S.DISCONNECTED, _S.IDLE, _S.MOVING, _S.ARMED, _S.FAULT}),
    _S.ARMED: frozenset({_S.SWEEPING, _S.FINISHING, _S.FAULT}),
    _S.SWEEPING: frozenset({_S.HOLDING, _S.FINISHING, _S.FAULT}),
    _S.HOLDING: frozenset({_S.SWEEPING, _S.FINISHING, _S.FAULT}),
    _S.FINISHING: frozenset({_S.IDLE, _S.DISCONNECTED, _S.FAULT}),
    _S.FAULT: frozenset({_S.FINISHING, _S.IDLE, _S.DISCONNECTED}),
}


class IllegalTransitionError(RuntimeError):
    """A transition that the table does not have: a bug, never an operator's mistake."""


def transition(current: State, wanted: State) -> State:
    """Return ``wanted`` if the table allows it from ``current``.

    Raises:
        IllegalTransitionError: the table has no such transition.
    """
    if wanted != current and wanted not in TRANSITIONS[current]:
        raise IllegalTransitionError(f"{current} -> {wanted}")
    return wanted


def outcome_words(outcome: Outcome | str, committed: int, expected: int) -> str:
    """The line that people read; SAVED is said only of a complete scan with nothing missing."""
    if outcome == Outcome.COMPLETE and committed == expected:
        return f"SAVED: {committed} of {expected} frames are safe"
    return f"{outcome}: {committed} of {expected} frames are safe"
