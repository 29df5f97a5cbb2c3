"""The daemon's front desk: one method for each command, allowed or refused by the rig's state, in plain words."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from acquire.cameras.protocol import CameraSettings
from acquire.contract.errors import CommandRefusedError
from acquire.contract.states import State
from acquire.stages.protocol import StageStatus

from .events import PauseRequested, ResumeRequested, StopRequested
from .preparing import PreparedScan, estimated_duration_s, prepare_scan
from .requests import (
    AcknowledgeRequest,
    CameraRequest,
    GotoRequest,
    JogRequest,
    LampRequest,
    NoArguments,
    ResumeScanRequest,
    ScanRequest,
    parse_request,
)
from .resuming import prepare_resume

if TYPE_CHECKING:
    from .daemon import Daemon

Result = dict[str, Any]


class Desk:
    """Serves commands. Each method returns what the reply carries or raises why it was refused."""

    def __init__(self, daemon: Daemon) -> None:
        self._daemon = daemon

    def serve(self, name: str, args: dict[str, Any]) -> Result:
        """Check a command's arguments and do it.

        Raises:
            SweepscopeError: refused; the text says why and what to do.
        """
        request = parse_request(name, args)
        result: Result = getattr(self, f"_{name}")(request)
        return result

    def _need_idle(self, what: str) -> None:
        daemon = self._daemon
        if daemon.scan is not None:
            raise CommandRefusedError(f"cannot {what}: a scan is running; stop it first")
        if daemon.board.state is not State.IDLE:
            raise CommandRefusedError(f"cannot {what}: the rig is {daemon.board.state}; wait, or stop it")

    # ---- the sweep ----

    def _scan(self, request: ScanRequest) -> Result:
        daemon = self._daemon
        stage = self._need_sweep("start a scan", request.mode or daemon.config.rig.sweep.mode)
        prepared = prepare_scan(
            request, daemon.config, daemon.rig, daemon.camera_info.format, daemon.settings, stage.zero_id
        )
        return self._begin(prepared)

    def _resume_scan(self, request: ResumeScanRequest) -> Result:
        daemon = self._daemon
        self._need_sweep("resume a scan", "step")
        prepared, settings = prepare_resume(Path(request.path), daemon.config, daemon.camera_info.format)
        daemon.settings = daemon.rig.camera.configure(settings)
        return self._begin(prepared)

    def _need_sweep(self, what: str, mode: str) -> StageStatus:
        self._need_idle(what)
        stage, info = self._daemon.rig.stage.status(), self._daemon.stage_info
        if not stage.position_trusted:
            raise CommandRefusedError(f"cannot {what}: the stage's position is not trusted; home it first")
        if mode not in info.modes:
            raise CommandRefusedError(
                f"the {info.kind} stage sweeps in {' or '.join(info.modes)} mode, not in {mode} mode"
            )
        return stage

    def _begin(self, prepared: PreparedScan) -> Result:
        daemon = self._daemon
        daemon.begin_scan(prepared)
        plan = prepared.start.plan
        return {
            "scan_uid": prepared.start.scan_uid,
            "path": str(prepared.folder),
            "expected": plan.count,
            "seconds": estimated_duration_s(plan, daemon.config),
            "bytes": plan.count * prepared.start.format.nbytes,
            "warnings": list(prepared.warnings),
        }

    def _pause(self, request: NoArguments) -> Result:
        scan = self._daemon.scan
        if scan is None or not scan.sweep.can_pause:
            raise CommandRefusedError("there is nothing to pause: no sweep is taking frames")
        scan.handle(PauseRequested(), self._daemon.clock.now_ns())
        return {"state": scan.sweep.state}

    def _resume(self, request: NoArguments) -> Result:
        scan = self._daemon.scan
        if scan is None or not scan.sweep.paused:
            raise CommandRefusedError("there is nothing to resume: no sweep is paused")
        scan.handle(ResumeRequested(), self._daemon.clock.now_ns())
        return {"state": scan.sweep.state}

    def _stop(self, request: NoArguments) -> Result:
        """Always allowed: ends the sweep or the move; on an idle rig it does nothing."""
        daemon = self._daemon
        if daemon.scan is not None:
            daemon.scan.handle(StopRequested(), daemon.clock.now_ns())
            return {"stopping": "scan"}
        daemon.rig.stage.stop()
        return {"stopping": "stage"}

    def _status(self, request: NoArguments) -> Result:
        fields: Result = msgspec.to_builtins(self._daemon.current_status(self._daemon.clock.now_ns()))
        return fields

    # ---- the stage, the lamp, the camera ----

    def _goto(self, request: GotoRequest) -> Result:
        self._need_idle("move")
        self._daemon.rig.stage.move_to(request.position_steps)
        self._daemon.enter(State.MOVING)
        return {"target_steps": request.position_steps}

    def _jog(self, request: JogRequest) -> Result:
        return self._goto(GotoRequest(self._daemon.rig.stage.status().position_steps + request.steps))

    def _home(self, request: NoArguments) -> Result:
        self._need_idle("home")
        self._daemon.rig.stage.home()
        self._daemon.enter(State.HOMING)
        return {}

    def _zero(self, request: NoArguments) -> Result:
        self._need_idle("zero")
        self._daemon.rig.stage.zero_here()
        return {}

    def _lamp(self, request: LampRequest) -> Result:
        self._need_idle("switch the lamp")
        self._daemon.rig.set_lamp(on=request.on)
        return {"on": request.on}

    def _camera(self, request: CameraRequest) -> Result:
        self._need_idle("change the camera's settings")
        wanted = {name: value for name, value in msgspec.structs.asdict(request).items() if value is not None}
        merged = msgspec.structs.asdict(self._daemon.settings) | wanted
        self._daemon.settings = self._daemon.rig.camera.configure(CameraSettings(**merged))
        return dict(msgspec.structs.asdict(self._daemon.settings))

    # ---- the rest ----

    def _acknowledge(self, request: AcknowledgeRequest) -> Result:
        return {"acknowledged": self._daemon.board.acknowledge(request.code)}

    def _shutdown(self, request: NoArguments) -> Result:
        self._daemon.ending = True
        return {}
