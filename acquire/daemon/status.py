"""Makes the status message out of what each part of the daemon knows. Pure."""

from __future__ import annotations

import msgspec

from acquire.activities.runner import ActivityStatus
from acquire.cameras.protocol import CameraInfo, CameraSettings
from acquire.contract.config.model import StageConfig
from acquire.contract.messaging.messages import FaultReport, Status
from acquire.contract.states import State
from acquire.contract.units import steps_to_um
from acquire.stages.protocol import StageInfo, StageStatus

from .scan_supervisor import ScanStatus


def status_message(
    config: StageConfig,
    stage: StageStatus,
    stage_info: StageInfo,
    camera_info: CameraInfo,
    camera_settings: CameraSettings,
    activity: ActivityStatus,
    scan: ScanStatus,
    *,
    state: State,
    faults: list[FaultReport],
    message: str,
    counters: dict[str, int],
    control: str,
    lamp_warm_s: float,
    writer_alive: bool,
) -> Status:
    """The rig as it is now. The fields of ``activity`` and ``scan`` bear the names that they have in the message."""
    return Status(
        state=state,
        position_steps=stage.position_steps,
        position_um=steps_to_um(stage.position_steps, config.um_per_microstep),
        position_trusted=stage.position_trusted,
        zero_id=stage.zero_id,
        travel_steps=(config.travel_min_steps, config.travel_max_steps),
        stage_kind=stage_info.kind,
        stage_version=stage_info.version[:128],
        camera_kind=camera_info.kind,
        camera=msgspec.structs.asdict(camera_settings),
        camera_limits=camera_info.limits,
        format=camera_info.format,
        lamp_on=stage.lamp_on,
        lamp_warm_s=lamp_warm_s,
        writer_alive=writer_alive,
        counters=counters,
        faults=faults,
        message=message,
        control=control,
        **msgspec.structs.asdict(activity),
        **msgspec.structs.asdict(scan),
    )
