"""When each action of the scan screen can be done, by the rig's state; the reasons in words; pure."""

from __future__ import annotations

from acquire.contract.messaging.messages import Status
from acquire.contract.states import HoldReason, State
from tui.text.status_text import is_running, state_words

RESTING = frozenset({State.IDLE, State.PREVIEW})
_STATES: dict[str, frozenset[str]] = {
    "start": RESTING,
    "pause": frozenset({State.SWEEPING, State.HOLDING}),
    "resume": frozenset({State.HOLDING}),
    "preview": RESTING | {State.MOVING, State.HOMING},
    "expose": RESTING,
    "lamp": RESTING,
    "jog": RESTING | {State.MOVING},
    "hold": RESTING | {State.MOVING},
    "home": RESTING,
    "zero": RESTING,
    "goto": RESTING,
    "prescan": RESTING,
}
_BUSY = frozenset({"start", "expose", "lamp", "home", "zero", "goto", "prescan", "jog", "hold", "adjust"})
"""What does not go together with :data:`ACTIVITIES`."""
ACTIVITIES = frozenset({"exposure", "prescan", "specimen", "capture"})
"""What the rig does one at a time, and soon ends."""
_TRUSTED = frozenset({"start", "goto", "prescan", "set_first", "set_last"})
_KNOWN = _BUSY | _TRUSTED | _STATES.keys() | {"use_proposal"}


def why_not(action: str, status: Status | None) -> str:
    """Why ``action`` cannot be done now; empty if it can. Actions that the rig does not mind are not looked at."""
    if action not in _KNOWN:
        return ""
    if status is None:
        return "nothing is known of the rig"
    return _by_sweep(action, status) or _by_state(action, status) or _by_rest(action, status)


def _by_sweep(action: str, status: Status) -> str:
    if action == "pause" and status.hold_reason == HoldReason.PAUSED:
        return "the sweep is paused already: r resumes"
    if action == "adjust" and is_running(status):
        return "the camera's settings are locked during a sweep"
    if action == "resume" and status.state == State.HOLDING and status.hold_reason != HoldReason.PAUSED:
        return f"the sweep holds by itself ({status.hold_reason}) and goes on by itself"
    return ""


def _by_state(action: str, status: Status) -> str:
    wanted = _STATES.get(action)
    return f"not while the rig is {state_words(status)}" if wanted is not None and status.state not in wanted else ""


def _by_rest(action: str, status: Status) -> str:
    if action == "use_proposal" and status.proposal is None:
        return "there is no proposal: w looks for the bounds"
    if action in _TRUSTED and not status.position_trusted:
        return "the position is not trusted: h homes"
    return busy_words(status) if action in _BUSY else ""


def busy_words(status: Status | None) -> str:
    """Why the rig begins nothing else now; empty if it may."""
    if status is None or status.activity not in ACTIVITIES:
        return ""
    return f"{status.activity} is running: wait, or STOP"
