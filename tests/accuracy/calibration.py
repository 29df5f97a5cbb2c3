"""Remakes the calibration figures of docs/accuracy.md on the simulated rig: `python -m tests.accuracy.calibration DIR`.

Everything is estimated from images alone: a board in 15 tilts, sweeps over it flat and tilted, then dome and stirrup
against their truth. Takes about five minutes.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import msgspec
import numpy as np

from acquire.contract.config.simulation import SimulationConfig
from acquire.simulation import Renderer, build_scene
from tests.fakes.scans.simulated_scans import UM_PER_MICROSTEP, simulate_sweep
from tui.cli import run

SIZE = (1024, 768)
TILTS = (
    (0, 0, 0), (20, 0, 5), (-20, 0, -8), (0, 20, 12), (0, -20, 3), (14, 14, -15), (14, -14, 20), (-14, 14, -4),
    (-14, -14, 9), (25, 5, 90), (-5, 25, 45), (8, -8, -30), (-9, -3, 60), (5, 12, 10), (-24, 8, 2),
)  # fmt: skip
NOISE = 2.0
BLUR_PX = 1.0
FINE = 2


def photograph(folder: Path, board: SimulationConfig) -> None:
    """The board in all tilts by room light: rendered fine, made coarse, blurred, noisy."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, (tilt_x, tilt_y, yaw) in enumerate(TILTS):
        config = msgspec.structs.replace(
            board, tilt_x_deg=tilt_x, tilt_y_deg=tilt_y, yaw_deg=yaw, seed=100 + index, read_noise_counts=0.0
        )
        scene = build_scene(config, width=SIZE[0] * FINE, height=SIZE[1] * FINE, um_per_microstep=UM_PER_MICROSTEP)
        fine = Renderer(scene).render(0, lamp=0.0, exposure_ms=60.0, gain=6.0, brightness=0.0)
        coarse = cv2.resize(fine.astype(np.float64), SIZE, interpolation=cv2.INTER_AREA)
        soft = cv2.GaussianBlur(coarse, (0, 0), BLUR_PX)
        noise = np.random.default_rng(index).normal(0, NOISE, soft.shape)
        cv2.imwrite(str(folder / f"{index:02d}.png"), np.clip(soft + noise, 0, 255).round().astype(np.uint8))


def main() -> None:
    """Photograph, sweep, calibrate, reconstruct; prints what the commands say."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--squares", default="41x31")
    parser.add_argument("--square-mm", type=float, default=0.15)
    parser.add_argument("--method", default="auto")
    options = parser.parse_args()
    columns, rows = (int(part) for part in options.squares.split("x"))
    folder = options.folder
    board = SimulationConfig(
        object="checkerboard", colour=False, board_columns=columns, board_rows=rows,
        board_square_mm=options.square_mm, read_noise_counts=NOISE, full_well_electrons=0.0,
    )  # fmt: skip
    photograph(folder / "views", board)
    for name, tilt in (("flat", 0.0), ("tilted", 10.0), ("tilted-back", -10.0)):
        simulate_sweep(folder / name, msgspec.structs.replace(board, tilt_x_deg=tilt), size=SIZE)
    pattern = ["--squares", options.squares, "--square-mm", str(options.square_mm), "--force"]
    camera, calibration = str(folder / "camera.json"), str(folder / "calibration.json")
    run(["calibrate", "camera", str(folder / "views"), *pattern, "--stage", "00.png", "--out", camera])
    sweeps = [str(folder / name) for name in ("flat", "tilted", "tilted-back")]
    method = ["--method", options.method]
    run(["calibrate", "plane", *sweeps, *pattern, "--camera", camera, "--out", calibration, *method])
    for name in ("dome", "stirrup"):
        thing = msgspec.structs.replace(board, object=name)
        simulate_sweep(folder / name, thing, size=SIZE, with_truth=True)
        run(["reconstruct", str(folder / name), "--calibration", calibration, *method])
        print(name, json.loads((folder / name / "report.json").read_text())["truth"])


if __name__ == "__main__":
    main()
