"""The paper's way beside ours: `python -m tests.accuracy.quarter_circle DIR`, after `tests.accuracy.calibration DIR`.

A sweep over a white flat on the simulated rig; the quarter circle is found in it with the camera that was calibrated
from images, and the light plane set beside that from sweeps over boards and beside the exact one.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from acquire.contract.config.simulation import SimulationConfig
from acquire.simulation import build_scene, ideal_calibration
from process.calibration.calibration_file import write_document
from tests.accuracy.calibration import NOISE, SIZE
from tests.fakes.scans.simulated_scans import UM_PER_MICROSTEP, plan_of, simulate_sweep
from tui.cli import run


def main() -> None:
    """Sweep, calibrate, compare; prints what the command says."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    white = SimulationConfig(object="flat", colour=False, read_noise_counts=NOISE, full_well_electrons=0.0)
    if not (folder / "white" / "scan.h5").exists():
        simulate_sweep(folder / "white", white, size=SIZE)
    scene = build_scene(white, width=SIZE[0], height=SIZE[1], um_per_microstep=UM_PER_MICROSTEP)
    plan = plan_of()
    exact = ideal_calibration(scene, first_steps=0, steps_per_frame=plan.steps_per_frame, count=plan.count)
    write_document(folder / "exact.json", exact, force=True)
    for name, camera in (("exact", "exact.json"), ("from-images", "calibration.json")):
        out = folder / f"quarter-circle-{name}.json"
        run(["calibrate", "quarter-circle", str(folder / "white"), "--camera", str(folder / camera), "--out", str(out),
             "--force"])  # fmt: skip
        plane = json.loads(out.read_text())["light_plane"]
        angle = np.degrees(np.arccos(np.dot(plane["normal"], exact["light_plane"]["normal"])))
        speed = np.linalg.norm(plane["corner_velocity_mm"]) / np.linalg.norm(exact["light_plane"]["corner_velocity_mm"])
        print(f"camera {name}: normal {angle:.4f} degrees off the exact one, speed {100 * (speed - 1):+.4f} %")


if __name__ == "__main__":
    main()
