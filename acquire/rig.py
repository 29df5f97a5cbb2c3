"""Puts a rig together from its configuration: stage, camera, and what the simulated one knows about itself."""

from __future__ import annotations

import json
import threading
from dataclasses import dataclass
from pathlib import Path

from acquire.cameras.protocol import Camera
from acquire.contract.config_model import RigConfig
from acquire.contract.errors import ConfigError
from acquire.contract.layout import TRUTH_NAME
from acquire.contract.plan import SweepPlan
from acquire.stages.protocol import Stage


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

    def set_lamp(self, *, on: bool) -> None:
        """Switch the lamp."""
        self.stage.set_lamp(on=on)


class SimulatedRig(Rig):
    """The simulated camera under the simulated (or a twin's) stage."""

    def __init__(self, config: RigConfig) -> None:
        from acquire.cameras.simulated import SimulatedCamera  # noqa: PLC0415 - numba is only needed here
        from acquire.stages.simulated import SimulatedStage  # noqa: PLC0415

        self._camera = SimulatedCamera(config)
        stage = SimulatedStage(config.stage, self._camera.on_trigger, time_scale=config.simulation.time_scale)
        super().__init__(stage, self._camera)

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


def build_rig(config: RigConfig) -> Rig:
    """The rig that the configuration names.

    Raises:
        ConfigError: a driver that this version does not have.
    """
    if config.stage.kind == "simulated" and config.camera.kind == "simulated":
        return SimulatedRig(config)
    if config.stage.kind == "uno" and config.stage.port == "emulator" and config.camera.kind == "simulated":
        from .twin import TwinRig  # noqa: PLC0415 - it needs the AVR tools

        return TwinRig(config)
    raise ConfigError(
        f"no driver for stage.kind = '{config.stage.kind}' with camera.kind = '{config.camera.kind}' "
        "in this version: set both to 'simulated'"
    )
