"""What the terminal can do; the console is never opened where its pictures would end up in a pipe or a file."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping

from acquire.contract.errors import SweepscopeError

_MOUSE_OFF = "\x1b[?1000l\x1b[?1002l\x1b[?1003l\x1b[?1006l"
SSH_FRAMES_PER_S = "15"


def is_terminal() -> bool:
    """True if stdin, stdout and stderr are all terminals (Textual draws on stderr)."""
    return all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stdout, sys.stderr))


def require_terminal(what: str) -> None:
    """Raise SweepscopeError unless a person sits at all three streams."""
    missing = [
        name
        for name, stream in (("stdin", sys.stdin), ("stdout", sys.stdout), ("stderr", sys.stderr))
        if stream is None or not stream.isatty()
    ]
    if missing:
        raise SweepscopeError(
            f"{what} needs a terminal and {', '.join(missing)} is none: run it without pipes, "
            "or use 'sweepscope status' and 'sweepscope scan'"
        )


def prepare_terminal(environ: Mapping[str, str] = os.environ) -> None:
    """Quieten the terminal before Textual starts: mouse reports left on by a lost link, paint rate over SSH."""
    sys.stderr.write(_MOUSE_OFF)
    sys.stderr.flush()
    os.environ.setdefault("TEXTUAL_ANIMATIONS", "none")
    if environ.get("SSH_CONNECTION"):
        os.environ.setdefault("TEXTUAL_FPS", SSH_FRAMES_PER_S)
