"""The simulated rig: a camera that renders what lies where the stage stands."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from acquire.cameras.simulated import SimulatedCamera
from acquire.contract.config.model import RigConfig
from acquire.contract.config.simulation import SimulationConfig
from acquire.contract.plan import SweepPlan
from acquire.contract.scan_data.dataset_names import TRUTH_NAME
from acquire.simulation import ideal_calibration, truth, write_truth
from acquire.stages.protocol import Stage
from acquire.stages.simulated import SimulatedStage

from .base import Rig

logger = logging.getLogger(__name__)


class RenderedRig(Rig):
    """The simulated camera over any stage that knows its position."""

    def __init__(self, config: RigConfig, make_stage: Callable[[SimulatedCamera], Stage]) -> None:
        """``make_stage`` is given the camera, which the stage's triggers expose."""
        self._camera = SimulatedCamera(config, lambda: self.stage.status().position_steps)
        super().__init__(make_stage(self._camera), self._camera)

    def own_calibration(self, plan: SweepPlan) -> str:
        """The exact calibration of the simulated optics."""
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
        assert self._camera.scene is not None
        found = truth(self._camera.scene, plan.first_steps, plan.pitch_steps, plan.count)
        try:
            write_truth(folder / TRUTH_NAME, found)
        except OSError as error:
            logger.error("no ground truth: %s", error)  # noqa: TRY400

    def specimen(self, changes: dict[str, Any]) -> SimulationConfig:
        """The simulation as it is, with ``changes``."""
        return msgspec.structs.replace(self._camera.simulation, **changes)

    def show_specimen(self, simulation: SimulationConfig) -> str:
        """Compute the scene and show it from now on."""
        self._camera.show(simulation)
        tilts = f"tilted by {simulation.tilt_x_deg:g} and {simulation.tilt_y_deg:g} degrees"
        return f"{simulation.object}, {tilts}, turned by {simulation.yaw_deg:g}"


class SimulatedRig(RenderedRig):
    """The simulated camera over the simulated stage."""

    def __init__(self, config: RigConfig) -> None:
        def stage(camera: SimulatedCamera) -> Stage:
            return SimulatedStage(config.stage, camera.on_trigger, time_scale=config.simulation.time_scale)

        super().__init__(config, stage)

    def set_lamp(self, *, on: bool) -> None:
        """Switch the lamp; the camera sees it."""
        super().set_lamp(on=on)
        self._camera.lamp_on = on
