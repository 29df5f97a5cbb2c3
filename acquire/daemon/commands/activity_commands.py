"""Commands that begin an activity: the reply says that it began, the status message how it goes on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from acquire.activities.capture import Capture, capture_path
from acquire.activities.exposure_search import ExposureSearch
from acquire.activities.jog_hold import LEASE_MS, MOST_STEPS, JogHold
from acquire.activities.prescan import Prescan, prescan_positions
from acquire.activities.prescan_analysis import PrescanPictures, find_bounds, propose_exposure
from acquire.activities.runner import ActivityRunner
from acquire.activities.specimen import Specimen
from acquire.contract.config.load import LoadedConfig
from acquire.contract.errors import CommandRefusedError
from acquire.contract.messaging.messages import Proposal, Status
from acquire.contract.permissions import check_permission
from acquire.contract.units import NS_PER_MS, NS_PER_S, ns_from_ms
from acquire.daemon.lamp_timer import LampTimer
from acquire.daemon.requests import (
    Call,
    CaptureRequest,
    JogHoldRequest,
    NoArguments,
    PrescanRequest,
    Result,
    ScanRequest,
    SpecimenRequest,
)
from acquire.daemon.scan_setup import LONGEST_EXPOSURE_SHARE, estimated_duration_s, plan_of, space_for
from acquire.rigs.base import Rig

from .device_commands import within_travel


class ActivityCommands:
    """Handlers of the table of commands."""

    def __init__(
        self,
        rig: Rig,
        config: LoadedConfig,
        runner: ActivityRunner,
        lamp: LampTimer,
        current_status: Callable[[int], Status],
    ) -> None:
        self._rig, self._config, self._runner, self._lamp = rig, config, runner, lamp
        self._current_status = current_status
        self._hold: JogHold | None = None
        self._key_ns = 0
        """When the key of the hold was last reported as pressed, CLOCK_MONOTONIC."""

    # ---- motion while a key is held ----

    def jog_hold(self, request: JogHoldRequest, call: Call) -> Result:
        """Begin to move, or renew the lease of the move.

        A key that is still held after its hold has ended (by STOP, by a limit) begins no new one: so each press is
        noted before the table of permissions is asked.
        """
        hold = self._hold
        if hold is not None and hold.direction == request.direction:
            before_ns, self._key_ns = self._key_ns, call.now_ns
            if not hold.ended:
                hold.renew(call.now_ns)
                return _held(hold)
            if call.now_ns - before_ns < LEASE_MS * NS_PER_MS:
                raise CommandRefusedError(f"the hold is over, {hold.ended}: let the key go, and press it again")
        elif hold is not None and not hold.ended:
            hold.let_go()
            raise CommandRefusedError("the stage is slowing down to turn round: press again")
        return self._begin_hold(request, call)

    def _begin_hold(self, request: JogHoldRequest, call: Call) -> Result:
        check_permission("jog_hold", self._current_status(call.now_ns))
        stage = self._rig.stage
        here = stage.status().position_steps
        wanted = here + request.direction * MOST_STEPS
        target, limit = within_travel(wanted, self._rig, self._config.rig.stage)
        if target == here:
            raise CommandRefusedError(f"cannot jog: the stage is at {limit} already")
        hold = JogHold(
            stage,
            direction=request.direction,
            target_steps=target,
            limit=limit or f"the most of one hold ({MOST_STEPS} microsteps)",
            rate_steps_per_s=request.rate_steps_per_s,
        )
        self._runner.run(hold, call.now_ns)
        self._hold, self._key_ns = hold, call.now_ns
        return _held(hold)

    # ---- the exposure ----

    def expose(self, _request: NoArguments, call: Call) -> Result:
        """Search the exposure once."""
        if not self._rig.stage.status().lamp_on:
            raise CommandRefusedError(
                "cannot search the exposure: the lamp is off; switch it on and bring the light over the specimen"
            )
        warm_s = self._lamp.update(call.now_ns, on=True)
        if warm_s > 0:
            raise CommandRefusedError(f"cannot search the exposure: the lamp is warm in {warm_s:.0f} s; wait for it")
        shortest, longest = self._exposure_bounds_ms()
        self._runner.run(ExposureSearch(self._rig, self._runner.snap, (shortest, longest)), call.now_ns)
        return {"shortest_ms": shortest, "longest_ms": longest}

    def _exposure_bounds_ms(self) -> tuple[float, float]:
        """The camera's limits, and at most a share of a frame's period."""
        low, high = self._rig.camera_info.limits.get("exposure_ms", (0.01, 60_000.0))
        return low, max(low, min(high, LONGEST_EXPOSURE_SHARE * 1000 / self._config.rig.sweep.max_rate_hz))

    # ---- pictures and specimens ----

    def capture(self, request: CaptureRequest, call: Call) -> Result:
        """Write one full-size picture."""
        path = capture_path(request.path, self._config.data_dir)
        capture = Capture(path, self._rig.camera_info.format.pixel_format, self._runner.snap)
        self._runner.run(capture, call.now_ns)
        return {"path": str(path)}

    def specimen(self, request: SpecimenRequest, call: Call) -> Result:
        """Lay another specimen under the simulated camera."""
        wanted = {name: value for name, value in msgspec.structs.asdict(request).items() if value is not None}
        if "moved_um" in wanted:
            wanted["specimen_moved_um"] = wanted.pop("moved_um")
        simulation = self._rig.specimen(wanted)
        self._runner.run(Specimen(lambda: self._rig.show_specimen(simulation)), call.now_ns)
        return {name: getattr(simulation, name) for name in ("object", "tilt_x_deg", "tilt_y_deg", "yaw_deg")}

    # ---- the pre-scan ----

    def prescan(self, request: PrescanRequest, call: Call) -> Result:
        """Take pictures at some positions of a sweep and propose its bounds and exposure."""
        ends = ScanRequest(first_steps=request.first_steps, last_steps=request.last_steps)
        plan = plan_of(ends, self._config, self._rig.camera_settings)
        pitch = self._config.rig.sweep.steps_per_frame
        positions = prescan_positions(plan.first_steps, plan.last_steps, request.every_steps, pitch)
        self._rig.set_lamp(on=True)
        prescan = Prescan(
            self._rig,
            positions,
            self._runner.snap,
            settle_ns=ns_from_ms(plan.settle_ms * self._config.rig.time_scale),
            warm_up_ns=round(self._lamp.update(call.now_ns, on=True) * NS_PER_S),
            conclude=self._conclude,
            keep=self._runner.propose,
        )
        self._runner.run(prescan, call.now_ns)
        return {"looks": len(positions), "first_steps": positions[0], "last_steps": positions[-1]}

    def _conclude(self, pictures: PrescanPictures) -> tuple[Proposal, int]:
        """The proposal, and the position at which most of the specimen is lit."""
        config, settings = self._config, self._rig.camera_settings
        stage = config.rig.stage
        travel = stage.travel_min_steps, stage.travel_max_steps
        bounds = find_bounds(pictures, config.rig.reconstruct.contrast, travel)
        black = settings.brightness_percent / 100
        exposure_ms, warning = propose_exposure(pictures, settings.exposure_ms, black, self._exposure_bounds_ms())
        proposed: dict[str, Any] = {"first_steps": bounds.first_steps, "last_steps": bounds.last_steps}
        plan = plan_of(ScanRequest(**proposed), config, msgspec.structs.replace(settings, exposure_ms=exposure_ms))
        needed, free = space_for(config, plan, self._rig.camera_info.format)
        warnings = [*bounds.warnings, *filter(None, [warning])]
        if needed > free:
            warnings.append("the disk has too little room for this sweep")
        proposal = Proposal(
            **proposed,
            exposure_ms=exposure_ms,
            frames=plan.count,
            seconds=estimated_duration_s(plan, config),
            nbytes=needed,
            free_bytes=free,
            warnings=warnings,
        )
        return proposal, bounds.brightest_steps


def _held(hold: JogHold) -> Result:
    return {"target_steps": hold.target_steps, "limit": hold.limit, "lease_ms": LEASE_MS}
