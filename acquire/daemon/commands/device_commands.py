"""Commands to stage, lamp and camera while no scan runs."""

from __future__ import annotations

import msgspec

from acquire.activities.runner import ActivityRunner
from acquire.cameras.protocol import CameraSettings
from acquire.contract.config.model import StageConfig
from acquire.contract.errors import CommandRefusedError
from acquire.contract.states import State
from acquire.daemon.requests import (
    Call,
    CameraRequest,
    GotoRequest,
    JogRequest,
    LampRequest,
    NoArguments,
    PreviewRequest,
    Result,
)
from acquire.rigs.base import Rig

_UNITS = {"exposure_ms": " ms", "gain": " dB", "brightness_percent": " %"}


class DeviceCommands:
    """Handlers of the table of commands."""

    def __init__(self, rig: Rig, stage_config: StageConfig, runner: ActivityRunner) -> None:
        self._rig, self._stage_config, self._runner = rig, stage_config, runner

    # ---- the stage ----

    def goto(self, request: GotoRequest, _call: Call) -> Result:
        """Move to a position within the travel."""
        nearest, limit = within_travel(request.position_steps, self._rig, self._stage_config)
        if nearest != request.position_steps:
            raise CommandRefusedError(
                f"cannot move to {request.position_steps}: it is outside the travel, beyond {limit}"
            )
        return self._move(nearest)

    def jog(self, request: JogRequest, _call: Call) -> Result:
        """Move by some microsteps; a soft limit shortens the move, and the reply names it."""
        here = self._rig.stage.status().position_steps
        wanted = here + request.steps
        target, limit = within_travel(wanted, self._rig, self._stage_config)
        if target == here and target != wanted:
            raise CommandRefusedError(f"cannot move: the stage is at {limit} already")
        return self._move(target) | ({"clipped": limit} if target != wanted else {})

    def _move(self, position_steps: int) -> Result:
        self._rig.stage.move_to(position_steps)
        self._runner.moving(State.MOVING)
        return {"target_steps": position_steps}

    def home(self, _request: NoArguments, _call: Call) -> Result:
        """Find the limit switch."""
        self._rig.stage.home()
        self._runner.moving(State.HOMING)
        return {}

    def zero(self, _request: NoArguments, _call: Call) -> Result:
        """Call the present position zero."""
        self._rig.stage.zero_here()
        return {}

    # ---- lamp, camera, preview ----

    def lamp(self, request: LampRequest, _call: Call) -> Result:
        """Switch the lamp."""
        self._rig.set_lamp(on=request.on)
        return {"on": request.on}

    def camera(self, request: CameraRequest, _call: Call) -> Result:
        """Change settings of the camera; returns all of them as the camera uses them."""
        wanted = {name: value for name, value in msgspec.structs.asdict(request).items() if value is not None}
        for name, value in wanted.items():
            low, high = self._rig.camera_info.limits.get(name, (float("-inf"), float("inf")))
            if not low <= value <= high:
                raise CommandRefusedError(f"{name} {value:g} is outside the camera's {low:g}..{high:g}{_UNITS[name]}")
        merged = msgspec.structs.asdict(self._rig.camera_settings) | wanted
        return msgspec.structs.asdict(self._rig.configure_camera(CameraSettings(**merged)))

    def preview(self, request: PreviewRequest, _call: Call) -> Result:
        """Pictures on or off."""
        self._runner.set_preview(on=request.on, rate_hz=request.rate_hz)
        return {"on": request.on, "rate_hz": request.rate_hz}


def within_travel(position_steps: int, rig: Rig, config: StageConfig) -> tuple[int, str]:
    """The nearest position within the soft limits, and the limit's name; an untrusted position has no limits."""
    if not rig.stage.status().position_trusted:
        return position_steps, ""
    if position_steps > config.travel_max_steps:
        return config.travel_max_steps, f"the soft limit stage.travel_max_steps = {config.travel_max_steps}"
    if position_steps < config.travel_min_steps:
        return config.travel_min_steps, f"the soft limit stage.travel_min_steps = {config.travel_min_steps}"
    return position_steps, ""
