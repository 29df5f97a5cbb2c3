"""Why an action of the console cannot be done now, in words: by the daemon's own table of permissions; pure."""

from __future__ import annotations

from typing import Final

from acquire.contract.messaging.messages import Status
from acquire.contract.permissions import PERMISSIONS, why_not_offered

COMMAND_OF: Final = {
    "start": "scan",
    "hold": "jog_hold",
    "adjust": "camera",
    "sweep": "scan",
    "pose": "specimen",
    "object": "specimen",
}
"""Actions whose command has another name."""


def why_not(action: str, status: Status | None) -> str:
    """Why ``action`` cannot be done now; empty if it can, also for actions that do not concern the rig."""
    command = COMMAND_OF.get(action, action)
    if command not in PERMISSIONS and action not in ("use_proposal", "set_first", "set_last"):
        return ""
    if status is None:
        return "the state of the rig is not known"
    if action == "use_proposal":
        return "" if status.proposal is not None else "there is no proposal: w looks for the bounds"
    if action in ("set_first", "set_last"):
        return "" if status.position_trusted else "the position is not trusted: h homes"
    return why_not_offered(command, status)
