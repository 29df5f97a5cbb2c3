"""Remakes the figures of reference planes: `python -m tests.accuracy.reference_planes FROG-V1-LR WORK_DIR`.

Cameras from the ten board views by each estimate of the corners, planes from the sweep, both against the given ones.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from tui.cli import run

MIDDLE_MM = np.array([0.0, -20.0, 1650.0])


def differences(made: dict, given: dict) -> np.ndarray:
    """[frames, 2]: degrees, and mm at the middle of the scene."""
    first, theirs = given["light_plane"]["first_frame"], np.array(given["light_plane"]["planes"])
    found = []
    for number, plane in enumerate(np.array(made["light_plane"]["planes"]), made["light_plane"]["first_frame"]):
        if not first <= number < first + len(theirs):
            continue
        other = theirs[number - first] / np.linalg.norm(theirs[number - first][:3])
        own = plane / np.linalg.norm(plane[:3])
        place = MIDDLE_MM - (other[:3] @ MIDDLE_MM - other[3]) * other[:3]
        angle = np.degrees(np.arccos(min(abs(other[:3] @ own[:3]), 1.0)))
        found.append((angle, abs(own[:3] @ place - own[3])))
    return np.array(found)


def main() -> None:
    """Calibrate and compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--method", default="linear")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    scan, planes = str(options.folder / "frog.h5"), str(options.data / "calibration.json")
    given = json.loads(Path(planes).read_text())
    if not Path(scan).exists():
        run(["import", str(options.data / "frames"), scan])
    cameras = {"given": planes}
    for corners in ("auto", "saddle", "gradient"):
        cameras[corners] = str(options.folder / f"camera-{corners}.json")
        run(["calibrate", "camera", str(options.data / "checkerboard"), "--squares", "9x7", "--square-mm", "30",
             "--corners", corners, "--out", cameras[corners], "--force"])  # fmt: skip
    for name, camera in cameras.items():
        out = str(options.folder / f"planes-{name}.json")
        run(["calibrate", "reference-planes", scan, "--camera", camera, "--planes", planes, "--edge", "falling",
             "--method", options.method, "--out", out, "--force"])  # fmt: skip
        found = differences(json.loads(Path(out).read_text()), given)
        middle, worst = np.median(found, axis=0), found.max(axis=0)
        print(f"{name}: {len(found)} planes, median {middle[0]:.3f} degrees and {middle[1]:.2f} mm, "
              f"worst {worst[0]:.3f} degrees and {worst[1]:.2f} mm")  # fmt: skip


if __name__ == "__main__":
    main()
