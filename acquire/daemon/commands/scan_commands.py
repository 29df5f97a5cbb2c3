"""The daemon's front desk: one method for each command, allowed or refused by the rig's state, in plain words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from acquire.contract.errors import CommandRefusedError
from acquire.contract.states import State
from acquire.daemon.resume import prepare_resume, released_on_failure
from acquire.daemon.scan_setup import PreparedScan, check_scan, estimated_duration_s, prepare_scan
from acquire.stages.protocol import StageStatus
from acquire.sweep.events import PauseRequested, ResumeRequested, StopRequested

from .activity_commands import ActivityDesk
from .device_commands import Result
from .requests import AcknowledgeRequest, NoArguments, ResumeScanRequest, ScanRequest, parse_request


class Desk(ActivityDesk):
    """Serves commands. Each method returns what the reply carries or raises why it was refused."""

    def serve(self, name: str, args: dict[str, Any], client: str = "") -> Result:
        """Check a command's arguments and do it for ``client``.

        Raises:
            SweepscopeError: refused; the text says why and what to do.
        """
        request = parse_request(name, args)
        self._client = client
        if name != "jog_hold":  # asks by itself, after it has noted that the key is still held
            self._refuse_now(name)
        result: Result = getattr(self, f"_{name}")(request)
        return result

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
        self._need_stage("resume a scan")
        prepared, settings = prepare_resume(Path(request.path), daemon.config, daemon.camera_info.format)
        with released_on_failure(prepared.lock):
            self._check_mode(prepared.start.plan.mode)
            daemon.settings = daemon.rig.camera.configure(settings)
            return self._begin(prepared)

    def _need_sweep(self, what: str, mode: str) -> StageStatus:
        stage = self._need_stage(what)
        self._check_mode(mode)
        return stage

    def _need_stage(self, what: str) -> StageStatus:
        if self._daemon.camera_away:
            raise CommandRefusedError(f"cannot {what}: the camera is away ({self._daemon.camera_away}); plug it in")
        return self._daemon.rig.stage.status()

    def _check_mode(self, mode: str) -> None:
        info = self._daemon.stage_info
        if mode not in info.modes:
            raise CommandRefusedError(
                f"the {info.kind} stage sweeps in {' or '.join(info.modes)} mode, not in {mode} mode"
            )

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

    def _estimate(self, request: ScanRequest) -> Result:
        """What a scan would take, or why it would be refused; nothing is made, nothing moves."""
        daemon = self._daemon
        stage = daemon.rig.stage.status()
        self._check_mode(request.mode or daemon.config.rig.sweep.mode)
        found = check_scan(
            request, daemon.config, daemon.rig, daemon.camera_info.format, daemon.settings, stage.zero_id
        )
        warnings = list(found.warnings)
        if not stage.position_trusted:
            warnings.append("the stage's position is not trusted: home it first")
        return {
            "expected": found.plan.count,
            "seconds": estimated_duration_s(found.plan, daemon.config),
            "bytes": found.needed_bytes,
            "free_bytes": found.free_bytes,
            "warnings": warnings,
        }

    def _pause(self, request: NoArguments) -> Result:
        scan = self._daemon.scan
        if scan is None or not scan.sweep.can_pause:
            # the frames of a check are taken, which the status does not tell
            raise CommandRefusedError("cannot pause: no sweep is taking frames")
        scan.handle(PauseRequested(), self._daemon.clock.now_ns())
        return {"state": scan.sweep.state}

    def _resume(self, request: NoArguments) -> Result:
        scan = self._daemon.scan
        assert scan is not None  # the table of permissions
        scan.handle(ResumeRequested(), self._daemon.clock.now_ns())
        return {"state": scan.sweep.state}

    def _stop(self, request: NoArguments) -> Result:
        """Always allowed: ends the sweep or the move; on an idle rig it does nothing."""
        daemon = self._daemon
        if daemon.scan is not None:
            daemon.scan.handle(StopRequested(), daemon.clock.now_ns())
            return {"stopping": "scan"}
        what = daemon.interlude.activity.name if daemon.interlude.activity is not None else "stage"
        daemon.rig.stage.stop()
        daemon.interlude.stop()
        return {"stopping": what}

    def _status(self, request: NoArguments) -> Result:
        fields: Result = msgspec.to_builtins(self._daemon.current_status(self._daemon.clock.now_ns()))
        return fields

    # ---- the rest ----

    def _acknowledge(self, request: AcknowledgeRequest) -> Result:
        """A rig in fault is let go when every fault was seen; what its cause was, the stage itself still knows."""
        board = self._daemon.board
        count = board.acknowledge(request.code)
        if board.state is State.FAULT and all(fault.acknowledged for fault in board.faults):
            self._daemon.enter(State.IDLE)
        return {"acknowledged": count}

    def _shutdown(self, request: NoArguments) -> Result:
        self._daemon.ending = True
        return {}
