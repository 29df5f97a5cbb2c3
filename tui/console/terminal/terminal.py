"""What the terminal can do; the console is never opened where its output would end up in a pipe or a file."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Mapping, MutableMapping

from acquire.contract.errors import SweepscopeError
from tui.text.streams import draws_signs, keep_widths

_MOUSE_OFF = "\x1b[?1000l\x1b[?1002l\x1b[?1003l\x1b[?1006l"
SSH_FRAMES_PER_S = "15"
LEAST_WIDTH, LEAST_HEIGHT = 60, 20
"""Cells that the screens need."""
COLOURS = ("auto", "truecolor", "256", "16", "none")
_TEXTUAL_COLOURS = {"truecolor": "truecolor", "256": "256", "16": "standard", "none": "standard"}


def not_terminals() -> list[str]:
    """Those of stdin, stdout and stderr that are no terminal (Textual draws on stderr)."""
    streams = {"stdin": sys.stdin, "stdout": sys.stdout, "stderr": sys.stderr}
    return [name for name, stream in streams.items() if stream is None or not stream.isatty()]


def is_terminal() -> bool:
    """True if stdin, stdout and stderr are all terminals."""
    return not not_terminals()


def require_terminal(what: str, environ: Mapping[str, str] = os.environ) -> None:
    """Raise SweepscopeError unless stdin, stdout and stderr are all terminals that can place a cursor."""
    missing = not_terminals()
    if missing:
        raise SweepscopeError(
            f"{what} needs a terminal and {', '.join(missing)} is not one: run it without pipes, "
            "or use 'sweepscope status' and 'sweepscope scan'"
        )
    if environ.get("TERM") == "dumb":
        raise SweepscopeError(
            f"{what} needs a terminal that can place a cursor, and TERM=dumb cannot: open another terminal, "
            "or use 'sweepscope status' and 'sweepscope scan'"
        )


def colours_of(environ: Mapping[str, str], wanted: str = "auto") -> str:
    """How many colours to use: ``truecolor``, ``256``, ``16`` or ``none``.

    Truecolor only where the terminal says so: one that does not know it shows random colours.
    """
    if wanted != "auto":
        return wanted
    if environ.get("NO_COLOR") is not None:
        return "none"
    if environ.get("COLORTERM", "").lower() in ("truecolor", "24bit"):
        return "truecolor"
    term = environ.get("TERM", "")
    return "256" if "256" in term or term.startswith(("xterm-kitty", "tmux", "alacritty", "foot")) else "16"


def needs_ascii() -> bool:
    """True if the encoding of this terminal lacks our signs (Textual draws on stderr)."""
    return not draws_signs(sys.stderr)


def picture_mode(colours: str, *, ascii_only: bool) -> str:
    """How the camera picture is drawn: half blocks need grey levels, characters need nothing."""
    return "half" if colours in ("truecolor", "256") and not ascii_only else "mono"


def choose_colours(wanted: str, environ: MutableMapping[str, str] = os.environ) -> str:
    """Set the colours of this process; must be called before Textual is imported. Returns what was chosen."""
    colours = colours_of(environ, wanted)
    environ["TEXTUAL_COLOR_SYSTEM"] = _TEXTUAL_COLOURS[colours]
    if colours == "none":
        environ["NO_COLOR"] = "1"
    if environ.get("TMUX"):
        environ.setdefault("TEXTUAL_DISABLE_KITTY_KEY", "1")  # extended keys within tmux break ctrl+c and others
    return colours


def prepare_terminal(environ: MutableMapping[str, str] = os.environ) -> None:
    """Prepare the terminal before Textual starts: mouse reports left on by a lost link, paint rate over SSH.

    An exported COLUMNS or LINES is dropped: it would hide all later changes of the window's size. Where SIGINT was
    ignored (started in the background of a script), it is restored: child programs inherit it and are ended by it.
    """
    for name in ("COLUMNS", "LINES"):
        environ.pop(name, None)
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    keep_widths(sys.stderr)
    sys.stderr.write(_MOUSE_OFF)
    sys.stderr.flush()
    os.environ.setdefault("TEXTUAL_ANIMATIONS", "none")
    if environ.get("SSH_CONNECTION"):
        os.environ.setdefault("TEXTUAL_FPS", SSH_FRAMES_PER_S)
