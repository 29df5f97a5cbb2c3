"""Lets no child outlive its supervisor: a pipe that the child watches and that closes when the supervisor dies."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import MutableMapping

LIFELINE_VARIABLE = "SWEEPSCOPE_LIFELINE_FD"
GRACE_S = 12.0
"""A child that was told to end by the loss of its supervisor is ended by force after so long."""
_FORCED_EXIT_STATUS = 1


def follow_parent(environ: MutableMapping[str, str] = os.environ) -> threading.Thread | None:
    """Watch the pipe named by the environment, if any; its end means SIGTERM to this process, then the end by force.

    A pipe, unlike the kernel's parent-death signal, does not depend on which thread of the supervisor started us.
    """
    text = environ.pop(LIFELINE_VARIABLE, "")  # not for our own children: they do not inherit the pipe
    if not text.isdigit():
        return None
    watcher = threading.Thread(target=_watch, args=(int(text),), name="lifeline", daemon=True)
    watcher.start()
    return watcher


def _watch(descriptor: int) -> None:
    try:
        os.read(descriptor, 1)
    except OSError:
        return  # the number did not name our pipe: nobody to follow
    os.kill(os.getpid(), signal.SIGTERM)
    threading.Event().wait(GRACE_S)
    os._exit(_FORCED_EXIT_STATUS)
