"""Owns the widgets beside the picture: the text of the state, and (on a loopback page) the buttons that move the rig.

Callbacks are coroutines, so viser runs them one after the other in the order of the clicks; they only enqueue.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import viser

from acquire.contract.units import NS_PER_S

from .commands import CommandLine
from .feed import Snapshot
from .markup import STYLE, Picture, beat_html, note_html, panel_html
from .widgets import write
from .words import allowed, heading

BEAT_NS = NS_PER_S
MAX_NAME = 64
DEFAULT_NAME = "scan"


class Panel:
    """The texts; a view-only page has nothing else."""

    def __init__(self, server: viser.ViserServer, *, view_only: bool) -> None:
        self._view_only = view_only
        self._beat_ns = 0
        server.gui.configure_theme(
            dark_mode=True, show_logo=False, show_share_button=False, control_width="medium", brand_color=(47, 111, 168)
        )
        server.gui.main_panel.dock_right()
        server.gui.add_html(STYLE)  # apart from the text: a browser restyles the whole page when it comes anew
        self._beat = server.gui.add_html("")
        self._text = server.gui.add_html("")

    def show(self, snapshot: Snapshot, now_ns: int, picture: Picture) -> None:
        """Write what changed; the clock once a second."""
        write(self._text, content=panel_html(snapshot, now_ns, picture))
        if now_ns - self._beat_ns >= BEAT_NS:
            self._beat_ns = now_ns
            self._beat.content = beat_html(time.strftime("%H:%M:%S"), self._view_only)


class Controls:
    """Start, pause, resume and stop; each click becomes one request to the daemon."""

    def __init__(self, server: viser.ViserServer, commands: CommandLine) -> None:
        self._commands = commands
        gui = server.gui
        self._name = gui.add_text("Scan name", DEFAULT_NAME, hint="Name of the next scan's folder")
        self._buttons = {
            "scan": gui.add_button("Start", icon=viser.Icon.PLAYER_PLAY, color="green", disabled=True),
            "pause": gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE, disabled=True),
            "resume": gui.add_button("Resume", icon=viser.Icon.PLAYER_TRACK_NEXT, disabled=True),
            "stop": gui.add_button("Stop", icon=viser.Icon.PLAYER_STOP, color="red"),
        }
        self._note = gui.add_html("")
        for command, button in self._buttons.items():
            button.on_click(self._enqueue(command))

    def _enqueue(self, command: str) -> Callable[[Any], Any]:
        async def clicked(_event: Any) -> None:
            args = {"name": self._scan_name()} if command == "scan" else {}
            self._commands.submit(command, args)

        return clicked

    def _scan_name(self) -> str:
        return str(self._name.value).strip()[:MAX_NAME] or DEFAULT_NAME

    def show(self, snapshot: Snapshot, now_ns: int) -> None:
        """Enable what makes sense now, and say what became of the last click."""
        may = allowed(snapshot.status, live=heading(snapshot, now_ns).live)
        for command, button in self._buttons.items():
            write(button, disabled=not may[command])
        write(self._note, content=note_html(self._commands.note, now_ns))
