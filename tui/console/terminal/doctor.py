"""`sweepscope console doctor`: what this terminal and its link can do, and the fix for what they cannot."""

from __future__ import annotations

import os
import re
import select
import shutil
import subprocess
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from tui.console.terminal.terminal import LEAST_HEIGHT, LEAST_WIDTH, colours_of

ANSWER_S = 2.0
"""Longest wait for the terminal's answer; over SSH it may take a second."""
LOAD_BYTES = 40_000
_ASK = "\x1b[6n"
_ASK_SYNC = "\x1b[?2026$p"
_NOTHING = "\x1b[0m"
"""Four bytes that change nothing on the screen."""
SLOW_BYTES_PER_S = 100_000


@dataclass(frozen=True)
class TerminalFinding:
    """One line of the doctor's report."""

    name: str
    value: str
    fix: str = ""
    """What to do; empty if nothing is wrong."""


@dataclass(frozen=True)
class Measured:
    """What the terminal answered."""

    round_trip_s: float | None
    """None: no answer."""
    rate_bytes_per_s: float | None
    """None: faster than could be measured, or no answer."""
    synchronised: bool
    """It knows synchronised output: a picture appears in one go."""


def findings(
    environ: Mapping[str, str], size: tuple[int, int], measured: Measured, tmux: Mapping[str, str]
) -> list[TerminalFinding]:
    """The report; ``tmux`` holds its options by name, empty outside of tmux."""
    return [
        *_colours(environ),
        _size(size),
        *_tmux(environ, tmux),
        *_link(measured),
        _locale(environ),
    ]


def _colours(environ: Mapping[str, str]) -> Iterator[TerminalFinding]:
    term = environ.get("TERM", "")
    wrong = "" if term not in ("", "dumb") else "export TERM=xterm-256color"
    yield TerminalFinding("TERM", term or "not set", wrong)
    colours = colours_of(environ)
    fix = ""
    if colours == "16":
        fix = "if it has 256 colours: export TERM=xterm-256color; else the picture is drawn in characters"
    yield TerminalFinding("COLORTERM", environ.get("COLORTERM") or "not set")
    yield TerminalFinding("colours", f"{colours}; ssh does not pass COLORTERM on: --color truecolor says it", fix)


def _size(size: tuple[int, int]) -> TerminalFinding:
    small = size[0] < LEAST_WIDTH or size[1] < LEAST_HEIGHT
    return TerminalFinding(
        "size", f"{size[0]} x {size[1]} cells", f"at least {LEAST_WIDTH} x {LEAST_HEIGHT}" if small else ""
    )


def _tmux(environ: Mapping[str, str], tmux: Mapping[str, str]) -> Iterator[TerminalFinding]:
    if not environ.get("TMUX"):
        yield TerminalFinding("tmux", "no; in tmux a lost link leaves the console running: 'tmux new -A -s rig'")
        return
    yield TerminalFinding(
        "tmux", f"yes, passthrough {tmux.get('allow-passthrough', 'unknown')} (not needed: no pictures go by it)"
    )
    late = tmux.get("escape-time", "")
    if late.isdigit() and int(late) > 100:
        yield TerminalFinding("tmux escape-time", f"{late} ms", "Escape is slow: tmux set -sg escape-time 20")
    outer = tmux.get("client_termfeatures", "")
    if outer and "RGB" not in outer:
        yield TerminalFinding(
            "tmux colours", "256 to the outer terminal", "if it has truecolor: tmux set -as terminal-features ',*:RGB'"
        )


def _link(measured: Measured) -> Iterator[TerminalFinding]:
    if measured.round_trip_s is None:
        yield TerminalFinding(
            "round trip",
            "the terminal does not answer",
            "the picture's rate then follows this machine's own queue only",
        )
        return
    yield TerminalFinding("round trip", f"{1000 * measured.round_trip_s:.0f} ms")
    rate = measured.rate_bytes_per_s
    if rate is None:
        yield TerminalFinding("link", "faster than 2 MB/s")
    else:
        slow = rate < SLOW_BYTES_PER_S
        fix = "ssh -C compresses; --picture off saves most of it" if slow else ""
        yield TerminalFinding("link", f"{rate / 1000:.0f} kB/s", fix)
    yield TerminalFinding(
        "synchronised output", "yes" if measured.synchronised else "no: pictures may tear, nothing else"
    )


def _locale(environ: Mapping[str, str]) -> TerminalFinding:
    name = environ.get("LC_ALL") or environ.get("LC_CTYPE") or environ.get("LANG") or ""
    utf8 = "utf-8" in name.lower() or "utf8" in name.lower()
    return TerminalFinding("locale", name or "not set", "" if utf8 else "export LANG=C.UTF-8, or start with --ascii")


# ---- measuring ----


def examine(say: Callable[[str], None], environ: Mapping[str, str] = os.environ) -> int:
    """Measure this terminal and say what was found; returns the number of things to fix."""
    size = shutil.get_terminal_size()
    found = findings(environ, (size.columns, size.lines), measure(), _tmux_options(environ))
    for finding in found:
        say(f"{'!' if finding.fix else ' '} {finding.name:<20} {finding.value}")
        if finding.fix:
            say(f"  {'':<20} fix: {finding.fix}")
    return sum(bool(finding.fix) for finding in found)


def measure() -> Measured:
    """Ask the terminal on stdin and stderr; restores its modes, swallows late answers."""
    with _raw(sys.stdin.fileno()):
        answer, round_trip_s = _ask(_ASK_SYNC + _ASK)
        if round_trip_s is None:
            return Measured(None, None, synchronised=False)
        synchronised = re.search(r"\x1b\[\?2026;[1-4]\$y", answer) is not None
        _, loaded_s = _ask(_NOTHING * (LOAD_BYTES // len(_NOTHING)) + _ASK)
    held_s = loaded_s - round_trip_s if loaded_s is not None else 0.0
    return Measured(round_trip_s, LOAD_BYTES / held_s if held_s > 0.02 else None, synchronised)


@contextmanager
def _raw(descriptor: int) -> Iterator[None]:
    before = termios.tcgetattr(descriptor)
    try:
        tty.setcbreak(descriptor)
        yield
    finally:
        termios.tcsetattr(descriptor, termios.TCSAFLUSH, before)


def _ask(text: str) -> tuple[str, float | None]:
    """The answer to a text that ends with the question for the cursor, and how long it took; None: none came."""
    begin_s = time.monotonic()
    sys.stderr.write(text)
    sys.stderr.flush()
    answer = ""
    while (left_s := begin_s + ANSWER_S - time.monotonic()) > 0:
        if not select.select([sys.stdin], [], [], left_s)[0]:
            break
        answer += os.read(sys.stdin.fileno(), 1024).decode(errors="replace")
        if re.search(r"\x1b\[\d+;\d+R", answer):
            return answer, time.monotonic() - begin_s
    return answer, None


def _tmux_options(environ: Mapping[str, str]) -> dict[str, str]:
    if not environ.get("TMUX"):
        return {}
    asked = {
        "allow-passthrough": ["show-options", "-gv", "allow-passthrough"],
        "escape-time": ["show-options", "-sv", "escape-time"],
        "client_termfeatures": ["display-message", "-p", "#{client_termfeatures}"],
    }
    return {name: _tmux_says(words) for name, words in asked.items()}


def _tmux_says(words: list[str]) -> str:
    try:
        done = subprocess.run(["tmux", *words], capture_output=True, text=True, timeout=ANSWER_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return "unknown"
    return done.stdout.strip()
