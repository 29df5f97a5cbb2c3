"""The buttons that move the rig; only a page that is bound to loopback has them.

Callbacks are coroutines, so viser runs them one after the other in the order of the clicks; they only enqueue. Each
one first checks whether this browser may give the command; the daemon checks again.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from acquire.contract.messaging.messages import Status
from process.viewer.rig_client.commands import CommandThread
from process.viewer.rig_client.control import BrowserControl
from process.viewer.rig_client.feed import Snapshot
from process.viewer.status_html import note_html, small_html
from process.viewer.status_text import allowed, heading

from .widgets import write

MAX_NAME = 64
DEFAULT_NAME = "scan"
STEPS = ("-100", "-10", "-1", "+1", "+10", "+100")
HOLD_HZ = 10.0
"""Beats of a jog button that is held; without one for 300 ms the daemon stops the stage."""
REFUSED_S = 6.0
MAX_STEPS = 10_000_000


class RigPanel:
    """Start, pause, resume, stop; jog, go to, home; preview, lamp; who holds control."""

    def __init__(self, server: viser.ViserServer, commands: CommandThread) -> None:
        self._server = server
        self._commands = commands
        self._control = BrowserControl()
        self._status: Status | None = None
        stop = server.gui.add_button("Stop", icon=viser.Icon.PLAYER_STOP, color="red", hint="Works for everybody")
        self._buttons: dict[str, Any] = {"stop": stop}
        stop.on_click(self._enqueue("stop", dict))
        server.on_client_connect(self._greet)
        server.on_client_disconnect(self._farewell)

    def fill(self) -> None:
        """Make all but the stop, which stands over the tabs."""
        gui = self._server.gui
        self._name = gui.add_text("Scan name", DEFAULT_NAME, hint="Name of the next scan's folder")
        self._buttons |= {
            "scan": gui.add_button("Start", icon=viser.Icon.PLAYER_PLAY, color="green", disabled=True),
            "pause": gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE, disabled=True),
            "resume": gui.add_button("Resume", icon=viser.Icon.PLAYER_TRACK_NEXT, disabled=True),
        }
        self._note = gui.add_html("")
        self._add_control()
        self._add_stage()
        for command, button in self._buttons.items():
            if command != "stop":
                button.on_click(self._enqueue(command, self._arguments(command)))

    def _add_control(self) -> None:
        gui = self._server.gui
        with gui.add_folder("Control"):
            self._holder = gui.add_html("")
            hold = gui.add_button_group("", ("Take control", "Give it back"), hint="Others then only look")
        hold.on_click(self._change_control)

    def _add_stage(self) -> None:
        gui = self._server.gui
        with gui.add_folder("Stage, camera, lamp", expand_by_default=False):
            jog = gui.add_button_group("Jog (steps)", STEPS)
            backward = gui.add_button("Hold to move back", icon=viser.Icon.CHEVRONS_LEFT)
            forward = gui.add_button("Hold to move forward", icon=viser.Icon.CHEVRONS_RIGHT)
            self._rate = gui.add_slider("Steps/s", min=20, max=1000, step=20, initial_value=200)
            self._target = gui.add_number("Go to (steps)", 0, min=-MAX_STEPS, max=MAX_STEPS, step=1)
            self._buttons["goto"] = gui.add_button("Go", icon=viser.Icon.ARROW_RIGHT)
            self._buttons["home"] = gui.add_button("Home", icon=viser.Icon.HOME)
            self._preview = gui.add_button_group("Preview", ("On", "Off"))
            self._lamp = gui.add_button_group("Lamp", ("On", "Off"))
        self._moving = (backward, forward)  # groups of buttons cannot be disabled; there the daemon refuses
        jog.on_click(self._enqueue("jog", lambda: {"steps": int(jog.value)}))
        for button, direction in ((backward, -1), (forward, 1)):
            button.on_hold(self._enqueue("jog_hold", self._holding(direction)), callback_hz=HOLD_HZ)
        self._preview.on_click(self._enqueue("preview", lambda: {"on": self._preview.value == "On"}))
        self._lamp.on_click(self._enqueue("lamp", lambda: {"on": self._lamp.value == "On"}))

    def _holding(self, direction: int) -> Callable[[], dict[str, Any]]:
        return lambda: {"direction": direction, "rate_steps_per_s": float(self._rate.value)}

    def _arguments(self, command: str) -> Callable[[], dict[str, Any]]:
        if command == "scan":
            return lambda: {"name": str(self._name.value).strip()[:MAX_NAME] or DEFAULT_NAME}
        if command == "goto":
            return lambda: {"position_steps": round(self._target.value)}
        return dict

    # ---- from the browsers: the server's loop ----

    def _enqueue(self, command: str, arguments: Callable[[], dict[str, Any]]) -> Callable[[Any], Any]:
        async def clicked(event: Any) -> None:
            client_id = event.client_id if event.client_id is not None else -1
            why = self._control.refusal(self._status, client_id, command)
            if not why:
                self._commands.submit(command, arguments(), client=self._control.name(client_id))
            elif event.client is not None and command != "jog_hold":
                event.client.add_notification("Not done", why, auto_close_seconds=REFUSED_S, color="yellow")

        return clicked

    async def _change_control(self, event: Any) -> None:
        if event.client is not None:
            action = "take" if event.target.value == "Take control" else "release"
            self._commands.submit("control", {"action": action}, client=self._control.name(event.client_id))

    async def _greet(self, client: viser.ClientHandle) -> None:
        client.gui.add_html(small_html(f"you are {self._control.name(client.client_id)}"), order=-1e9)

    async def _farewell(self, client: viser.ClientHandle) -> None:
        """A browser that goes away gives control back; a jog that it held ends with its beats."""
        name = self._control.name(client.client_id)
        if self._status is not None and self._status.control == name:
            self._commands.submit("control", {"action": "release"}, client=name)

    # ---- in the main loop ----

    def show(self, snapshot: Snapshot, now_ns: int) -> None:
        """Enable what is offered now, show what became of the last click, keep control for its holder."""
        live = heading(snapshot, now_ns).live
        self._status = snapshot.status if live else None
        may = allowed(snapshot.status, live=live)
        for command, button in self._buttons.items():
            write(button, disabled=not may[command])
        for widget in self._moving:
            write(widget, disabled=not may["jog_hold"])
        write(self._note, content=note_html(self._commands.note, now_ns))
        write(self._holder, content=_holder_html(self._status))
        client_id = self._control.renewal(self._status, list(self._server.get_clients()), now_ns)
        if client_id is not None:
            self._commands.submit("control", {"action": "renew"}, client=self._control.name(client_id))


def _holder_html(status: Status | None) -> str:
    holder = status.control if status is not None else ""
    if holder:
        return small_html(" holds control; all others look", strong=holder)
    return small_html("no client holds control: all may act")
