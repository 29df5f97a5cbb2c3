"""The part of the front desk that begins activities: the exposure search, the pre-scan, and motion under a lease."""

from __future__ import annotations

from typing import Any

import msgspec

from acquire.activities.capture import Capture, capture_path
from acquire.activities.exposure_search import ExposureSearch
from acquire.activities.jog_hold import LEASE_MS, MOST_STEPS, JogHold
from acquire.activities.prescan import Prescan, look_positions
from acquire.activities.prescan_analysis import Looks, find_bounds, propose_exposure
from acquire.activities.specimen import Specimen
from acquire.contract.errors import CommandRefusedError
from acquire.contract.messaging.messages import Proposal
from acquire.contract.units import NS_PER_MS, NS_PER_S, ns_from_ms
from acquire.daemon.scan_setup import LONGEST_EXPOSURE_SHARE, estimated_duration_s, plan_of, space_for

from .device_commands import Result, RigDesk
from .requests import CaptureRequest, JogHoldRequest, NoArguments, PrescanRequest, ScanRequest, SpecimenRequest


class ActivityDesk(RigDesk):
    """Serves what takes its time: the reply says that it began, the status how it goes on."""

    _hold: JogHold | None = None
    _held_ns = 0

    # ---- motion as long as a key is held ----

    def _jog_hold(self, request: JogHoldRequest) -> Result:
        now_ns = self._daemon.clock.now_ns()
        hold = self._hold
        if hold is not None and hold.direction == request.direction:
            before_ns, self._held_ns = self._held_ns, now_ns
            if not hold.ended:
                hold.renew(now_ns)
                return self._held(hold)
            if now_ns - before_ns < LEASE_MS * NS_PER_MS:
                raise CommandRefusedError(f"the hold is over, {hold.ended}: let the key go, and press it again")
        elif hold is not None and not hold.ended:
            hold.let_go()
            raise CommandRefusedError("the stage is slowing down to turn round: press again")
        return self._begin_hold(request, now_ns)

    def _begin_hold(self, request: JogHoldRequest, now_ns: int) -> Result:
        self._refuse_now("jog_hold")
        stage = self._daemon.rig.stage
        here = stage.status().position_steps
        target, limit = self._within_travel(here + request.direction * MOST_STEPS)
        if target == here:
            raise CommandRefusedError(f"cannot jog: the stage is at {limit} already")
        hold = JogHold(
            stage,
            direction=request.direction,
            target_steps=target,
            limit=limit or f"the most of one hold ({MOST_STEPS} microsteps)",
            rate_steps_per_s=request.rate_steps_per_s,
        )
        self._daemon.interlude.run(hold, now_ns)
        self._hold, self._held_ns = hold, now_ns
        return self._held(hold)

    def _held(self, hold: JogHold) -> Result:
        return {"target_steps": hold.target_steps, "limit": hold.limit, "lease_ms": LEASE_MS}

    # ---- the exposure, searched once ----

    def _expose(self, request: NoArguments) -> Result:
        daemon = self._daemon
        lamp_on = daemon.rig.stage.status().lamp_on
        if not lamp_on:
            raise CommandRefusedError(
                "cannot search the exposure: the lamp is off; switch it on and bring the light over the specimen"
            )
        warm_s = daemon.board.lamp.update(daemon.clock.now_ns(), on=True)
        if warm_s > 0:
            raise CommandRefusedError(f"cannot search the exposure: the lamp is warm in {warm_s:.0f} s; wait for it")
        shortest, longest = self._exposure_bounds_ms()
        search = ExposureSearch(
            snap=daemon.interlude.snap,
            expose=self._set_exposure,
            exposure_ms=daemon.settings.exposure_ms,
            black=daemon.settings.brightness_percent / 100,
            bit_depth=daemon.camera_info.format.bit_depth,
            bounds_ms=(shortest, longest),
        )
        daemon.interlude.run(search, daemon.clock.now_ns())
        return {"shortest_ms": shortest, "longest_ms": longest}

    def _set_exposure(self, exposure_ms: float) -> float:
        daemon = self._daemon
        wanted = msgspec.structs.replace(daemon.settings, exposure_ms=exposure_ms)
        daemon.settings = daemon.rig.camera.configure(wanted)
        return daemon.settings.exposure_ms

    def _exposure_bounds_ms(self) -> tuple[float, float]:
        """What the camera can, within what a frame's period leaves."""
        low, high = self._daemon.camera_info.limits.get("exposure_ms", (0.01, 60_000.0))
        return low, max(low, min(high, LONGEST_EXPOSURE_SHARE * 1000 / self._daemon.config.rig.sweep.max_rate_hz))

    # ---- one picture in full size, and what lies under the simulated camera ----

    def _capture(self, request: CaptureRequest) -> Result:
        daemon = self._daemon
        path = capture_path(request.path, daemon.config.data_dir)
        activity = Capture(path, daemon.camera_info.format.pixel_format, daemon.interlude.snap)
        daemon.interlude.run(activity, daemon.clock.now_ns())
        return {"path": str(path)}

    def _specimen(self, request: SpecimenRequest) -> Result:
        daemon = self._daemon
        wanted = {name: value for name, value in msgspec.structs.asdict(request).items() if value is not None}
        if "moved_um" in wanted:
            wanted["specimen_moved_um"] = wanted.pop("moved_um")
        simulation = daemon.rig.specimen(wanted)
        daemon.interlude.run(Specimen(lambda: daemon.rig.show_specimen(simulation)), daemon.clock.now_ns())
        return {name: getattr(simulation, name) for name in ("object", "tilt_x_deg", "tilt_y_deg", "yaw_deg")}

    # ---- the pre-scan ----

    def _prescan(self, request: PrescanRequest) -> Result:
        daemon, sweep = self._daemon, self._daemon.config.rig.sweep
        ends = ScanRequest(first_steps=request.first_steps, last_steps=request.last_steps)
        plan = plan_of(ends, daemon.config, daemon.settings)
        positions = look_positions(plan.first_steps, plan.last_steps, request.every_steps, sweep.steps_per_frame)
        now_ns = daemon.clock.now_ns()
        daemon.rig.set_lamp(on=True)
        warm_s = daemon.board.lamp.update(now_ns, on=True)
        prescan = Prescan(
            positions,
            stage=daemon.rig.stage,
            snap=daemon.interlude.snap,
            frame_format=daemon.camera_info.format,
            settle_ns=ns_from_ms(plan.settle_ms * daemon.board.time_scale),
            warm_up_ns=round(warm_s * NS_PER_S),
            conclude=self._conclude,
            keep=daemon.interlude.propose,
        )
        daemon.interlude.run(prescan, now_ns)
        return {"looks": len(positions), "first_steps": positions[0], "last_steps": positions[-1]}

    def _conclude(self, looks: Looks) -> tuple[Proposal, int]:
        """The proposal, and where most of the specimen is lit."""
        config, settings = self._daemon.config, self._daemon.settings
        stage = config.rig.stage
        travel = stage.travel_min_steps, stage.travel_max_steps
        bounds = find_bounds(looks, config.rig.reconstruct.contrast, travel)
        black = settings.brightness_percent / 100
        exposure_ms, warning = propose_exposure(looks, settings.exposure_ms, black, self._exposure_bounds_ms())
        proposed: dict[str, Any] = {"first_steps": bounds.first_steps, "last_steps": bounds.last_steps}
        plan = plan_of(ScanRequest(**proposed), config, msgspec.structs.replace(settings, exposure_ms=exposure_ms))
        needed, free = space_for(config, plan, self._daemon.camera_info.format)
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
