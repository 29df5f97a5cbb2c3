"""Puts a rig together from its configuration: stage, camera, and what the simulated one knows about itself."""

from __future__ import annotations

import json
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from acquire.cameras.protocol import Camera, HostFiredCamera
from acquire.contract.config_model import RigConfig
from acquire.contract.errors import CommandRefusedError, ConfigError
from acquire.contract.layout import TRUTH_NAME
from acquire.contract.plan import SweepPlan
from acquire.contract.simulation_config import SimulationConfig
from acquire.stages.protocol import Stage, StageEvent, StageInfo, StageSink, Triggered

HOST_TRIGGER = "host"
"""``camera.trigger`` of a camera that runs freely."""


@dataclass
class Rig:
    """The devices of one daemon."""

    stage: Stage
    camera: Camera

    def own_calibration(self, plan: SweepPlan) -> str:
        """The calibration that the rig knows by itself (JSON); empty for a real one."""
        return ""

    def write_truth(self, folder: Path, plan: SweepPlan) -> threading.Thread | None:
        """Write what is really there beside the scan, in a thread; None for a real rig."""
        return None

    def open_stage(self, sink: StageSink) -> StageInfo:
        """Connect the stage; its events go to ``sink``."""
        return self.stage.open(sink)

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
        """Compute the scene and show it from now on; returns what lies there, in words. Called in a thread."""
        raise NotImplementedError


@dataclass
class HostFiredRig(Rig):
    """A camera without a trigger input: the host passes each shot on to it, so the stage must stand still."""

    camera: HostFiredCamera

    def open_stage(self, sink: StageSink) -> StageInfo:
        """Connect the stage; each trigger that it reports goes to the camera as well."""

        def tell(event: StageEvent) -> None:
            sink(event)
            if isinstance(event, Triggered):
                self.camera.fire(event.at_mono_ns, event.position_steps)

        return msgspec.structs.replace(self.stage.open(tell), modes=("step",))


class SimulatedRig(Rig):
    """The simulated camera under the simulated (or a twin's) stage."""

    def __init__(self, config: RigConfig) -> None:
        from acquire.cameras.simulated import SimulatedCamera  # noqa: PLC0415 - numba is only needed here
        from acquire.stages.simulated import SimulatedStage  # noqa: PLC0415

        self._camera = SimulatedCamera(config)
        stage = SimulatedStage(config.stage, self._camera.on_trigger, time_scale=config.simulation.time_scale)
        super().__init__(stage, self._camera)
        self._camera.where = lambda: stage.status().position_steps

    def own_calibration(self, plan: SweepPlan) -> str:
        """The exact calibration of the simulated optics."""
        from acquire.simulation import ideal_calibration  # noqa: PLC0415

        assert self._camera.scene is not None
        found = ideal_calibration(
            self._camera.scene,
            first_steps=plan.first_steps,
            steps_per_frame=plan.pitch_steps,
            count=plan.count,
            parameter="position_um",
        )
        return json.dumps(found)

    def write_truth(self, folder: Path, plan: SweepPlan) -> threading.Thread:
        """truth.h5 beside the scan."""
        thread = threading.Thread(target=self._write_truth, args=(folder, plan), name="truth", daemon=True)
        thread.start()
        return thread

    def _write_truth(self, folder: Path, plan: SweepPlan) -> None:
        from acquire.simulation import truth, write_truth  # noqa: PLC0415

        assert self._camera.scene is not None
        found = truth(self._camera.scene, plan.first_steps, plan.pitch_steps, plan.count)
        write_truth(folder / TRUTH_NAME, found)

    def set_lamp(self, *, on: bool) -> None:
        """Switch the lamp; the camera sees it."""
        super().set_lamp(on=on)
        self._camera.lamp_on = on

    def specimen(self, changes: dict[str, Any]) -> SimulationConfig:
        """The simulation as it is, with ``changes``."""
        return msgspec.structs.replace(self._camera.simulation, **changes)

    def show_specimen(self, simulation: SimulationConfig) -> str:
        """Compute the scene and show it from now on."""
        self._camera.show(simulation)
        tilts = f"tilted by {simulation.tilt_x_deg:g} and {simulation.tilt_y_deg:g} degrees"
        return f"{simulation.object}, {tilts}, turned by {simulation.yaw_deg:g}"


def build_rig(config: RigConfig) -> Rig:
    """The rig that the configuration names.

    Raises:
        ConfigError: devices that cannot work together.
    """
    stage, camera = config.stage, config.camera
    if camera.kind == "simulated" and stage.kind == "simulated":
        return SimulatedRig(config)
    if camera.kind == "simulated" and stage.kind == "uno" and stage.port == "emulator":
        from .twin import TwinRig  # noqa: PLC0415 - it needs the AVR tools

        return TwinRig(config)
    if camera.kind == "simulated":
        raise ConfigError("a simulated camera sees no real stage: set camera.kind to your camera's, or 'replay'")
    if camera.kind in ("uvc", "replay") or camera.trigger == HOST_TRIGGER:
        return HostFiredRig(_stage(config), _host_fired(config))
    if stage.kind != "uno":
        raise ConfigError(
            f"a {stage.kind} stage has no TRIGGER wire: set camera.trigger = '{HOST_TRIGGER}', or use the Uno"
        )
    from .cameras.genicam import GenicamCamera  # noqa: PLC0415 - it loads the camera makers' libraries

    return Rig(_stage(config), GenicamCamera(camera))


def _stage(config: RigConfig) -> Stage:
    if config.stage.kind == "uno":
        from .stages.uno import UnoStage  # noqa: PLC0415 - only the chosen driver is loaded

        return UnoStage(config.stage)
    if config.stage.kind == "legacy":
        from .stages.legacy import LegacyStage  # noqa: PLC0415

        return LegacyStage(config.stage)
    from .stages.simulated import SimulatedStage  # noqa: PLC0415

    return SimulatedStage(config.stage, lambda *_shot: None, time_scale=config.simulation.time_scale)


def _host_fired(config: RigConfig) -> HostFiredCamera:
    if config.camera.kind == "replay":
        from .cameras.replay import ReplayCamera  # noqa: PLC0415

        return ReplayCamera(config)
    from .cameras.free_running import FreeRunningCamera  # noqa: PLC0415

    if config.camera.kind == "uvc":
        from .cameras.uvc import UvcSource  # noqa: PLC0415

        return FreeRunningCamera(UvcSource(config.camera))
    from .cameras.genicam import GenicamDevice  # noqa: PLC0415

    return FreeRunningCamera(GenicamDevice(config.camera))
