"""Acquire/rigs/simulated.py."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import msgspec

from acquire.contract.config.model import RigConfig
from acquire.contract.config.simulation import SimulationConfig
from acquire.contract.plan import SweepPlan
from acquire.contract.scan_data.dataset_names import TRUTH_NAME
from acquire.rigs.base import Rig


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
