"""Which command may be given when: one table that the daemon, the console and the viewer read.

The daemon refuses a command by it; the console and the viewer offer no command that the daemon would refuse. Not in
the table is what a client cannot know from the status alone (whether the camera is away, whether a position lies
within the travel): the handler of a command checks that. Pure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from acquire.contract.messaging.messages import Status

from .errors import CommandRefusedError
from .states import RUNNING_STATES, HoldReason, State

_ANY: Final = frozenset(State)
_RESTING: Final = frozenset({State.IDLE, State.PREVIEW})
_TAKING: Final = frozenset({State.SWEEPING, State.HOLDING})


@dataclass(frozen=True)
class Permission:
    """When one command is done, and who may give it."""

    purpose: str
    """What the command does; completes ``cannot ...:`` in a refusal."""
    states: frozenset[State] = _ANY
    """States of the rig in which it is done."""
    alone: bool = False
    """Refused while an activity (an exposure search, a pre-scan, a capture) runs; the preview is none."""
    hold_reason: HoldReason | None = None
    """The sweep must hold for this reason; None: any reason, or none."""
    trusted_position: bool = False
    """The stage's position must be trusted."""
    prolongs: str = ""
    """Allowed in every state while this activity runs, because the command keeps it going."""
    no_effect_in: HoldReason | None = None
    """Done, but without effect, while the sweep holds for this reason: clients do not offer it then."""
    in_scan: str = "a scan is running; stop it first"
    """Reason of a refusal because of a running scan."""
    otherwise: str = ""
    """Reason of a refusal because of any state; empty: the reason names the state."""
    needs_control: bool = True
    """Refused while another client holds control."""
    for_observers: bool = False
    """A client that only watches may give it: it changes nothing, or it stops the rig."""
    never_late: bool = False
    """Done however long it was on the way; all others are refused when they come late."""

    @property
    def always(self) -> bool:
        """True if nothing of the rig can refuse it."""
        return self.states == _ANY


def _at_rest(purpose: str, **more: Any) -> Permission:
    """A command for a rig that does nothing, or only previews."""
    return Permission(purpose, states=_RESTING, alone=True, **more)


PERMISSIONS: Final[dict[str, Permission]] = {
    "scan": _at_rest("start a scan", trusted_position=True),
    "resume_scan": _at_rest("resume a scan", trusted_position=True),
    "estimate": Permission("estimate a scan", needs_control=False, for_observers=True),
    "pause": Permission("pause", states=_TAKING, no_effect_in=HoldReason.PAUSED, otherwise="no sweep is taking frames"),
    "resume": Permission(
        "resume", states=frozenset({State.HOLDING}), hold_reason=HoldReason.PAUSED, otherwise="no sweep is paused"
    ),
    "stop": Permission("stop", needs_control=False, for_observers=True, never_late=True),
    "status": Permission("show the status", needs_control=False, for_observers=True, never_late=True),
    "goto": _at_rest("move"),
    "jog": _at_rest("move"),
    "jog_hold": _at_rest("jog", prolongs="jog"),
    "home": _at_rest("home"),
    "zero": _at_rest("zero"),
    "lamp": _at_rest("switch the lamp"),
    "camera": _at_rest("change the camera's settings"),
    "preview": Permission(
        "preview",
        states=_RESTING | {State.MOVING, State.HOMING},
        in_scan="a scan is running, and its pictures are shown already",
    ),
    "expose": _at_rest("search the exposure"),
    "prescan": _at_rest("pre-scan", trusted_position=True),
    "capture": _at_rest("take a picture"),
    "specimen": _at_rest("change the specimen"),
    "control": Permission("change control", needs_control=False),
    "acknowledge": Permission("acknowledge a fault"),
    "shutdown": Permission("shut down"),
}
"""Every command of the daemon."""


def refusal(command: str, status: Status) -> str:
    """Why the daemon refuses ``command`` in this state of the rig; empty if it does not.

    Control is another matter: :func:`needs_control`.
    """
    row, state = PERMISSIONS[command], status.state
    if row.prolongs and status.activity == row.prolongs:
        return ""
    if row.alone and state not in RUNNING_STATES and status.activity not in ("", "preview"):
        return f"{status.activity} is running; wait, or stop it"
    if state not in row.states:
        return row.otherwise or _wrong_state(row, state)
    if row.hold_reason is not None and status.hold_reason != row.hold_reason:
        return f"the sweep holds by itself ({status.hold_reason}) and goes on by itself"
    if row.trusted_position and not status.position_trusted:
        return "the stage's position is not trusted; home it first"
    return ""


def _wrong_state(row: Permission, state: str) -> str:
    if state in RUNNING_STATES:
        return row.in_scan
    if state == State.FAULT:
        return "the rig is in fault; remove its cause and acknowledge it"
    if state == State.DISCONNECTED:
        return "the stage or the camera is not connected"
    return f"the rig is {state}; wait, or stop it"


def check_permission(command: str, status: Status) -> None:
    """Refuse ``command`` where the table does.

    Raises:
        CommandRefusedError: says why.
    """
    reason = refusal(command, status)
    if reason:
        raise CommandRefusedError(f"cannot {PERMISSIONS[command].purpose}: {reason}")


def why_not_offered(command: str, status: Status) -> str:
    """Why a client offers no ``command`` now: it would be refused, or change nothing; empty if it is offered."""
    row = PERMISSIONS[command]
    if row.no_effect_in is not None and status.hold_reason == row.no_effect_in and status.state in row.states:
        return f"the sweep is {row.no_effect_in} already"
    return refusal(command, status)


def never_late(command: str) -> bool:
    """True if ``command`` is done however long it was on the way."""
    return command in PERMISSIONS and PERMISSIONS[command].never_late


def needs_control(command: str) -> bool:
    """True if ``command`` is refused while another client holds control; commands that do not exist are too."""
    return command not in PERMISSIONS or PERMISSIONS[command].needs_control


BEGIN_WORK = frozenset({"scan", "resume_scan", "goto", "jog", "home", "expose", "prescan", "capture"})
"""Commands whose reply says that the work has begun, not that it is over."""


def accepted_words(name: str) -> str:
    """What a positive reply to the command means: ``begun`` or ``done``."""
    return "begun" if name in BEGIN_WORK else "done"
