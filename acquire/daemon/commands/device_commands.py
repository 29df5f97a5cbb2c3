"""The part of the front desk that serves stage, lamp, camera, preview and control; what would harm is refused in words.

Everything here happens beside no sweep: a running one refuses all of it but the stop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from acquire.cameras.protocol import CameraSettings
from acquire.contract.errors import CommandRefusedError
from acquire.contract.permissions import PERMISSIONS, refusal
from acquire.contract.states import State

from .requests import CameraRequest, ControlRequest, GotoRequest, JogRequest, LampRequest, NoArguments, PreviewRequest

if TYPE_CHECKING:
    from acquire.daemon.service import Daemon

Result = dict[str, Any]
_UNITS = {"exposure_ms": " ms", "gain": " dB", "brightness_percent": " %"}


class RigDesk:
    """Serves commands to the devices. Each method returns what the reply carries or raises why it was refused."""

    def __init__(self, daemon: Daemon) -> None:
        self._daemon = daemon
        self._client = ""

    def _refuse_now(self, command: str) -> None:
        """Raise where the table of permissions refuses a command in the present state of the rig."""
        reason = refusal(command, self._daemon.current_status(self._daemon.clock.now_ns()))
        if reason:
            raise CommandRefusedError(f"cannot {PERMISSIONS[command].purpose}: {reason}")

    # ---- the stage ----

    def _goto(self, request: GotoRequest) -> Result:
        self._check_travel(request.position_steps)
        return self._move(request.position_steps)

    def _jog(self, request: JogRequest) -> Result:
        """Clipped at the soft limits, and says so."""
        here = self._daemon.rig.stage.status().position_steps
        wanted = here + request.steps
        target, limit = self._within_travel(wanted)
        if target == here and target != wanted:
            raise CommandRefusedError(f"cannot move: the stage is at {limit} already")
        return self._move(target) | ({"clipped": limit} if target != wanted else {})

    def _move(self, position_steps: int) -> Result:
        self._daemon.rig.stage.move_to(position_steps)
        self._daemon.interlude.moving(State.MOVING)
        return {"target_steps": position_steps}

    def _home(self, request: NoArguments) -> Result:
        self._daemon.rig.stage.home()
        self._daemon.interlude.moving(State.HOMING)
        return {}

    def _zero(self, request: NoArguments) -> Result:
        self._daemon.rig.stage.zero_here()
        return {}

    def _within_travel(self, position_steps: int) -> tuple[int, str]:
        """The nearest position within the soft limits, and the limit's name; untrusted positions have no limits."""
        stage = self._daemon.config.rig.stage
        if not self._daemon.rig.stage.status().position_trusted:
            return position_steps, ""
        if position_steps > stage.travel_max_steps:
            return stage.travel_max_steps, f"the soft limit stage.travel_max_steps = {stage.travel_max_steps}"
        if position_steps < stage.travel_min_steps:
            return stage.travel_min_steps, f"the soft limit stage.travel_min_steps = {stage.travel_min_steps}"
        return position_steps, ""

    def _check_travel(self, position_steps: int) -> None:
        nearest, limit = self._within_travel(position_steps)
        if nearest != position_steps:
            raise CommandRefusedError(f"cannot move to {position_steps}: it is outside the travel, beyond {limit}")

    # ---- the lamp and the camera ----

    def _lamp(self, request: LampRequest) -> Result:
        self._daemon.rig.set_lamp(on=request.on)
        return {"on": request.on}

    def _camera(self, request: CameraRequest) -> Result:
        wanted = {name: value for name, value in msgspec.structs.asdict(request).items() if value is not None}
        for name, value in wanted.items():
            self._check_setting(name, value)
        merged = msgspec.structs.asdict(self._daemon.settings) | wanted
        self._daemon.settings = self._daemon.rig.camera.configure(CameraSettings(**merged))
        return dict(msgspec.structs.asdict(self._daemon.settings))

    def _check_setting(self, name: str, value: float) -> None:
        low, high = self._daemon.camera_info.limits.get(name, (float("-inf"), float("inf")))
        if not low <= value <= high:
            raise CommandRefusedError(f"{name} {value:g} is outside the camera's {low:g}..{high:g}{_UNITS[name]}")

    # ---- the preview ----

    def _preview(self, request: PreviewRequest) -> Result:
        self._daemon.interlude.set_preview(on=request.on, rate_hz=request.rate_hz)
        return {"on": request.on, "rate_hz": request.rate_hz}

    # ---- control ----

    def _control(self, request: ControlRequest) -> Result:
        now_ns = self._daemon.clock.now_ns()
        self._daemon.control.change(request.action, self._client, now_ns)
        return {"holder": self._daemon.control.holder(now_ns)}
