"""What the screens share on which one looks through the camera: pictures, lamp, exposure, and where the stage is."""

from __future__ import annotations

from typing import ClassVar

from acquire.contract.states import State
from tui.console.screens.base import RigScreenBase
from tui.console.screens.dialogs import Field, Form
from tui.console.state import scan_rules
from tui.console.state.scan_forms import parse_position

PREVIEW_HZ = 5.0


class CameraScreen(RigScreenBase):
    """A screen with the live picture; a subclass binds the actions to keys."""

    WANTS_PICTURES = True
    OF_CAMERA: ClassVar[frozenset[str]] = frozenset({"preview", "lamp", "expose", "goto"})
    """The shared actions: all of them change the rig."""

    def why_not(self, action: str) -> str:
        """The rig's state decides."""
        return scan_rules.why_not(action, self.view.status)

    def action_preview(self) -> None:
        """Pictures on or off."""
        status = self.view.status
        on = not (status is not None and (status.activity == "preview" or status.state == State.PREVIEW))
        self.send("preview", on=on, rate_hz=PREVIEW_HZ)

    def action_lamp(self) -> None:
        """Lamp on or off."""
        self.send("lamp", on=not (self.view.status is not None and self.view.status.lamp_on))

    def action_expose(self) -> None:
        """Search the exposure once, with the light over what is looked at: saturated pixels tell nothing."""
        self.send("expose")

    def goto_first_offers(self) -> int:
        """The position that the question begins with, in microsteps."""
        assert self.view.status is not None
        return self.view.status.position_steps

    def action_goto(self) -> None:
        """Ask where to."""
        draft, status = self.shell.draft, self.view.status
        assert status is not None
        low, high = status.travel_steps
        limits = f"microsteps {low} to {high}, or um (5010um)"
        where = Field("where", "go to", str(self.goto_first_offers()), help=limits)

        def go(position: int | None) -> None:
            if position is not None:
                self.send("goto", position_steps=position)

        def parse(texts: dict[str, str]) -> int:
            return parse_position(texts["where"], draft.um_per_microstep)

        self.shell.push_screen(Form("go to", [where], parse, done="moves"), go)
