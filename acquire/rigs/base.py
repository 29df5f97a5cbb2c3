"""A rig: one stage and one camera, what they are, and how the camera is set."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from acquire.cameras.protocol import Camera, CameraFrame, CameraGone, CameraInfo, CameraSettings, HostFiredCamera
from acquire.contract.config.simulation import SimulationConfig
from acquire.contract.errors import CommandRefusedError
from acquire.contract.plan import SweepPlan
from acquire.stages.protocol import Stage, StageEvent, StageInfo, StageSink, Triggered

HOST_TRIGGER = "host"
"""``camera.trigger`` of a camera that runs freely."""

DeviceEvent = StageEvent | CameraFrame | CameraGone


class Rig:
    """The devices of one daemon."""

    camera_info: CameraInfo
    """Known once the rig is open, as are the next two."""
    camera_settings: CameraSettings
    """As the camera uses them."""
    stage_info: StageInfo
    is_open = False
    """False until both devices are open: a device that never opened is not told to stop."""

    def __init__(self, stage: Stage, camera: Camera) -> None:
        self.stage, self.camera = stage, camera

    def open(self, sink: Callable[[DeviceEvent], None], settings: CameraSettings) -> None:
        """Connect and configure the camera, then connect the stage; ``sink`` is called from their threads.

        Raises:
            SweepscopeError: a device that is not there, or refuses; close both then.
        """
        self.camera_info = self.camera.open(sink)
        self.configure_camera(settings)
        self.stage_info = self.open_stage(sink)
        self.is_open = True

    def open_stage(self, sink: StageSink) -> StageInfo:
        """Connect the stage; its events go to ``sink``."""
        return self.stage.open(sink)

    def configure_camera(self, settings: CameraSettings) -> CameraSettings:
        """Set the camera; returns what it uses (limits, rounding)."""
        self.camera_settings = self.camera.configure(settings)
        return self.camera_settings

    def own_calibration(self, plan: SweepPlan) -> str:
        """The exact calibration of a simulated rig (JSON); empty for a real one."""
        return ""

    def write_truth(self, folder: Path, plan: SweepPlan) -> threading.Thread | None:
        """Write the ground truth beside the scan, in a thread; None for a real rig."""
        return None

    def set_lamp(self, *, on: bool) -> None:
        """Switch the lamp."""
        self.stage.set_lamp(on=on)

    def specimen(self, changes: dict[str, Any]) -> SimulationConfig:
        """The simulation with ``changes``; only a simulated rig has one.

        Raises:
            CommandRefusedError: a real rig, or a value out of its bounds.
        """
        raise CommandRefusedError("only the simulated rig can change its specimen: lay it on the stage by hand")

    def show_specimen(self, simulation: SimulationConfig) -> str:
        """Compute the scene and show it from now on; returns a description. Called in a thread."""
        raise NotImplementedError


class HostFiredRig(Rig):
    """A camera without a trigger input: the host passes each shot on to it, so the stage must stand still."""

    def __init__(self, stage: Stage, camera: HostFiredCamera) -> None:
        super().__init__(stage, camera)
        self._fire = camera.fire

    def open_stage(self, sink: StageSink) -> StageInfo:
        """Connect the stage; each trigger that it reports goes to the camera as well."""

        def tell(event: StageEvent) -> None:
            sink(event)
            if isinstance(event, Triggered):
                self._fire(event.at_mono_ns, event.position_steps)

        return msgspec.structs.replace(self.stage.open(tell), modes=("step",))
