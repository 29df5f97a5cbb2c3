"""Ends a child process when its supervisor dies: the child watches a pipe that closes with the supervisor.

The kernel's parent-death signal (PR_SET_PDEATHSIG) would not do: it fires when the thread that started the child ends,
and it cannot end a child that ignores SIGTERM.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import MutableMapping

LIFELINE_VARIABLE = "SWEEPSCOPE_LIFELINE_FD"
GRACE_S = 12.0
"""A child that has not ended so long after SIGTERM is killed."""
_FORCED_EXIT_STATUS = 1


def follow_parent(environ: MutableMapping[str, str] = os.environ) -> threading.Thread | None:
    """Watch the pipe named in the environment, if any; when it closes, send SIGTERM to this process, then exit hard."""
    text = environ.pop(LIFELINE_VARIABLE, "")  # our own children do not inherit the pipe
    if not text.isdigit():
        return None
    watcher = threading.Thread(target=_watch, args=(int(text),), name="lifeline", daemon=True)
    watcher.start()
    return watcher


def _watch(descriptor: int) -> None:
    try:
        os.read(descriptor, 1)
    except OSError:
        return  # the number is not our pipe: there is no supervisor
    os.kill(os.getpid(), signal.SIGTERM)
    threading.Event().wait(GRACE_S)
    os._exit(_FORCED_EXIT_STATUS)
