"""Waits until the rig is at rest again after a command; it asks for the status, as a published one may be older."""

from __future__ import annotations

import time
from typing import Any, Final

from acquire.contract.errors import NoServiceError
from tui.client.rig_client import RigClient

LONGEST_S: Final = 7200.0
"""A pre-scan may wait an hour for its lamp; everything has a deadline of its own in the daemon."""
LOOK_S: Final = 0.05
_BUSY: Final = ("moving", "homing")
_AT_REST: Final = ("", "preview")


def until_rest(client: RigClient, longest_s: float = LONGEST_S) -> dict[str, Any]:
    """The status in which nothing moves and no activity runs any more.

    Raises:
        NoServiceError: the daemon does not answer, or the rig does not rest in time.
    """
    deadline_s = time.monotonic() + longest_s
    while time.monotonic() < deadline_s:
        status = client.request("status").result
        if status["activity"] in _AT_REST and status["state"] not in _BUSY:
            return status
        time.sleep(LOOK_S)
    raise NoServiceError(f"the rig did not come to rest within {longest_s:.0f} s; see 'sweepscope status'")
