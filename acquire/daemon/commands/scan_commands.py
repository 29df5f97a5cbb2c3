"""Commands to scans: scan, resume_scan, estimate, pause, resume, and stop."""

from __future__ import annotations

from pathlib import Path

from acquire.activities.runner import ActivityRunner
from acquire.contract.config.load import LoadedConfig
from acquire.contract.errors import CommandRefusedError
from acquire.daemon.requests import Call, NoArguments, Result, ResumeScanRequest, ScanRequest
from acquire.daemon.resume import prepare_resume, released_on_failure
from acquire.daemon.scan_setup import PreparedScan, check_scan, estimated_duration_s, prepare_scan
from acquire.daemon.scan_supervisor import ScanSupervisor
from acquire.rigs.base import Rig
from acquire.sweep.events import PauseRequested, ResumeRequested, StopRequested


class ScanCommands:
    """Handlers of the table of commands."""

    def __init__(self, rig: Rig, config: LoadedConfig, scans: ScanSupervisor, runner: ActivityRunner) -> None:
        self._rig, self._config, self._scans, self._runner = rig, config, scans, runner

    def scan(self, request: ScanRequest, call: Call) -> Result:
        """Begin a scan."""
        self._need_camera("start a scan")
        self._check_mode(request.mode or self._config.rig.sweep.mode)
        return self._begin(prepare_scan(request, self._config, self._rig), call)

    def resume_scan(self, request: ResumeScanRequest, call: Call) -> Result:
        """Go on with an interrupted scan."""
        self._need_camera("resume a scan")
        prepared, settings = prepare_resume(Path(request.path), self._config, self._rig.camera_info.format)
        with released_on_failure(prepared.lock):
            self._check_mode(prepared.start.plan.mode)
            self._rig.configure_camera(settings)
            return self._begin(prepared, call)

    def _need_camera(self, what: str) -> None:
        if self._scans.camera_away:
            raise CommandRefusedError(f"cannot {what}: the camera is away ({self._scans.camera_away}); plug it in")

    def _check_mode(self, mode: str) -> None:
        info = self._rig.stage_info
        if mode not in info.modes:
            raise CommandRefusedError(
                f"the {info.kind} stage sweeps in {' or '.join(info.modes)} mode, not in {mode} mode"
            )

    def _begin(self, prepared: PreparedScan, call: Call) -> Result:
        self._scans.begin(prepared, call.now_ns)
        plan = prepared.start.plan
        return {
            "scan_uid": prepared.start.scan_uid,
            "path": str(prepared.folder),
            "expected": plan.count,
            "seconds": estimated_duration_s(plan, self._config),
            "bytes": plan.count * prepared.start.format.nbytes,
            "warnings": list(prepared.warnings),
        }

    def estimate(self, request: ScanRequest, _call: Call) -> Result:
        """What a scan would take, or why it would be refused; nothing is made, nothing moves."""
        self._check_mode(request.mode or self._config.rig.sweep.mode)
        found = check_scan(request, self._config, self._rig)
        warnings = list(found.warnings)
        if not self._rig.stage.status().position_trusted:
            warnings.append("the stage's position is not trusted: home it first")
        return {
            "expected": found.plan.count,
            "seconds": estimated_duration_s(found.plan, self._config),
            "bytes": found.needed_bytes,
            "free_bytes": found.free_bytes,
            "warnings": warnings,
        }

    def pause(self, _request: NoArguments, call: Call) -> Result:
        """Hold the sweep."""
        scan = self._scans.running
        if scan is None or not scan.sweep.can_pause:
            # while frames of a check are taken the status says SWEEPING, too: the table cannot refuse this
            raise CommandRefusedError("cannot pause: no sweep is taking frames")
        scan.handle(PauseRequested(), call.now_ns)
        return {"state": scan.sweep.state}

    def resume(self, _request: NoArguments, call: Call) -> Result:
        """Go on with a paused sweep."""
        scan = self._scans.running
        assert scan is not None  # by the table of permissions
        scan.handle(ResumeRequested(), call.now_ns)
        return {"state": scan.sweep.state}

    def stop(self, _request: NoArguments, call: Call) -> Result:
        """End the scan, or the activity and the move; without effect on an idle rig."""
        if self._scans.running is not None:
            self._scans.running.handle(StopRequested(), call.now_ns)
            return {"stopping": "scan"}
        what = self._runner.activity.name if self._runner.activity is not None else "stage"
        self._rig.stage.stop()
        self._runner.stop()
        return {"stopping": what}
