"""What the screens with a live picture share: pictures, lamp, exposure, moving the stage to a position."""

from __future__ import annotations

from typing import ClassVar

from acquire.contract.states import State
from tui.console.screens.base import RigScreenBase
from tui.console.screens.dialogs import FormDialog, FormField
from tui.console.state import scan_rules
from tui.console.state.next_scan import NextScan
from tui.text.positions import parse_position

PREVIEW_HZ = 5.0


class CameraScreen(RigScreenBase):
    """A screen with the live picture; a subclass binds the actions to keys."""

    WANTS_PICTURES = True
    OF_CAMERA: ClassVar[frozenset[str]] = frozenset({"preview", "lamp", "expose", "goto"})
    """The shared actions: all of them change the rig."""

    @property
    def next_scan(self) -> NextScan:
        """The sweep that is being prepared."""
        return self.shell.state.next_scan

    def why_not(self, action: str) -> str:
        """The state of the rig decides."""
        return scan_rules.why_not(action, self.view.status)

    def action_preview(self) -> None:
        """Camera pictures without a sweep, on or off."""
        status = self.view.status
        on = not (status is not None and (status.activity == "preview" or status.state == State.PREVIEW))
        self.send("preview", on=on, rate_hz=PREVIEW_HZ)

    def action_lamp(self) -> None:
        """Lamp on or off."""
        self.send("lamp", on=not (self.view.status is not None and self.view.status.lamp_on))

    def action_expose(self) -> None:
        """Search the exposure once; the light must be over the specimen, because saturated pixels tell nothing."""
        self.send("expose")

    def default_target(self) -> int:
        """The position that the form for ``goto`` begins with, in microsteps."""
        assert self.view.status is not None
        return self.view.status.position_steps

    def action_goto(self) -> None:
        """Ask for a position and move there."""
        assert self.view.status is not None
        low, high = self.view.status.travel_steps
        limits = f"microsteps {low} to {high}, or um (5010um)"
        field = FormField("where", "go to", str(self.default_target()), help=limits)
        um_per_microstep = self.next_scan.um_per_microstep
        form = FormDialog(
            "go to", [field], lambda texts: parse_position(texts["where"], um_per_microstep), done="moves"
        )
        self.ask(form, lambda position: self.send("goto", position_steps=position))
