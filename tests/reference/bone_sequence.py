"""Makes tests/data/bone: a small sequence of pictures for the tests, with its calibration and its truth.

    python -m tests.reference.bone_sequence tests/data/bone

The simulator renders it: no picture, camera or specimen of anybody else is in it. The known figures in
``tests/system/worker/test_reconstruct_real.py`` come from ``two_pass.py`` and from the truth, not from what they test.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import numpy as np

from acquire.contract.config.simulation import SimulationConfig
from acquire.simulation import Renderer, build_scene, truth
from acquire.simulation.calibration import ideal_calibration

WIDTH, HEIGHT, COUNT, STEPS = 64, 48, 66, 24
UM_PER_MICROSTEP = 3.175
# a close camera and a wide edge: few pixels and few frames, and still one frame and more for each edge
CONFIG = SimulationConfig(object="stirrup", seed=7, camera_distance_mm=40.0, edge_width_um=90.0)


def make(folder: Path) -> None:
    """Write frames/000.png .. 065.png (8 bit, RGB), calibration.json and truth.npz into ``folder``."""
    scene = build_scene(CONFIG, width=WIDTH, height=HEIGHT, um_per_microstep=UM_PER_MICROSTEP)
    renderer = Renderer(scene)
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    for k in range(COUNT):
        frame = renderer.render(STEPS * k, exposure_ms=30.0, gain=6.0, brightness=0.0)
        path = folder / "frames" / f"{k:03}.png"
        cv2.imwrite(str(path), cv2.cvtColor(frame, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    calibration = ideal_calibration(scene, first_steps=0, steps_per_frame=STEPS, count=COUNT, parameter="frame")
    del calibration["light_plane"]["method"]  # it is exact, whichever estimate makes the points
    (folder / "calibration.json").write_text(json.dumps(calibration, indent=1) + "\n")
    known = truth(scene, 0, STEPS, COUNT)
    np.savez_compressed(
        folder / "truth.npz",
        points_mm=known.points.astype(np.float32),
        crossing=known.crossing.astype(np.float32),
        visible=known.visible,
    )


if __name__ == "__main__":
    make(Path(sys.argv[1]))
