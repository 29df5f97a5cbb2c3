"""Remakes the figures of reference planes: `python -m tests.accuracy.reference_planes SEQUENCE WORK_DIR`.

SEQUENCE holds ``frames/`` and ``planes.json``, or a ``calibration.json`` with camera and planes. Cameras come from ten
board views by each estimate of the corners, and the given one where there is one; planes from the sweep. The noise of
wall and floor is printed.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from acquire.contract.calibration import load_calibration
from process.calibration.reference_planes.known_planes import read_planes
from process.cloud.light_planes import planes_at
from process.cloud.triangulation import rays
from tui.cli import run

MIDDLE_MM = np.array([0.0, -20.0, 1650.0])
UNRELIABLE = 1 | 2 | 128
"""Quality bits of crossings that make no point."""


@dataclass(frozen=True)
class Spread:
    """How points of one reference plane scatter, in mm."""

    points: int
    about_fit_mm: float
    """1.4826 x MAD of the distance from a robustly fitted plane."""
    about_markers_mm: float
    """The same from the plane of the markers."""


def spread(scan_folder: Path, calibration: Path, planes: Path) -> tuple[dict[str, Spread], int]:
    """Scatter of the points in the region of each reference plane, by its name; and the number of all points."""
    found = load_calibration(calibration)[0]
    with h5py.File(scan_folder / "maps.h5") as maps:
        crossing, quality = maps["crossing"][()], maps["quality"][()]
    crossing[(quality & UNRELIABLE) != 0] = np.nan
    known = np.isfinite(crossing)
    plane = planes_at(found.light_plane, np.where(known, crossing, 0).ravel() + 1)
    seen = rays(found.camera)
    depth = (plane[:, 3] - plane[:, :3] @ seen.centre_mm) / (plane[:, :3] * seen.directions).sum(axis=1)
    points = (seen.centre_mm + depth[:, None] * seen.directions).reshape(*crossing.shape, 3)
    points[~known] = np.nan
    out = {}
    for wanted in read_planes(planes, found.camera):
        left, right, top, bottom = wanted.region
        inside = points[top : bottom + 1, left : right + 1].reshape(-1, 3)
        inside = inside[np.isfinite(inside[:, 0])]
        out[wanted.name] = Spread(len(inside), _about_fit(inside), _sigma(inside @ wanted.normal - wanted.offset))
    return out, int(np.isfinite(points[..., 0]).sum())


def _sigma(distance: np.ndarray) -> float:
    return float(1.4826 * np.median(np.abs(distance - np.median(distance))))


def _about_fit(points: np.ndarray) -> float:
    kept = points
    for _ in range(10):
        middle = kept.mean(axis=0)
        distance = (points - middle) @ np.linalg.svd(kept - middle, full_matrices=False)[2][2]
        kept = points[np.abs(distance) < 4 * _sigma(distance)]
    return _sigma(distance)


def differences(made: dict, given: dict) -> np.ndarray:
    """[frames, 2]: degrees, and mm at the middle of the scene; frames without a plane are left out."""
    first, theirs = given["light_plane"]["first_frame"], given["light_plane"]["planes"]
    found = []
    for number, plane in enumerate(made["light_plane"]["planes"], made["light_plane"]["first_frame"]):
        if plane is None or not first <= number < first + len(theirs):
            continue
        own, other = (np.array(values) / np.linalg.norm(values[:3]) for values in (plane, theirs[number - first]))
        place = MIDDLE_MM - (other[:3] @ MIDDLE_MM - other[3]) * other[:3]
        angle = np.degrees(np.arccos(min(abs(other[:3] @ own[:3]), 1.0)))
        found.append((angle, abs(own[:3] @ place - own[3])))
    return np.array(found)


def main() -> None:
    """Calibrate, compare and reconstruct."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--board", type=Path, help="folder of the board views; default: checkerboard in SEQUENCE")
    parser.add_argument("--method", default="auto")
    parser.add_argument("--edge", default="falling")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    scan = options.folder / "scan.h5"
    if not scan.exists():
        run(["import", str(options.data / "frames"), str(scan)])
    given = options.data / "calibration.json"
    planes = given if given.exists() else options.data / "planes.json"
    cameras = {"given": given} if given.exists() else {}
    for corners in ("auto", "saddle", "gradient"):
        cameras[corners] = options.folder / f"camera-{corners}.json"
        board = options.board or options.data / "checkerboard"
        run(["calibrate", "camera", str(board), "--squares", "9x7", "--square-mm", "30",
             "--corners", corners, "--out", str(cameras[corners]), "--force"])  # fmt: skip
    for name, camera in cameras.items():
        out = options.folder / f"planes-{name}.json"
        run(["calibrate", "reference-planes", str(scan), "--camera", str(camera), "--planes", str(planes),
             "--edge", options.edge, "--method", options.method, "--out", str(out), "--force"])  # fmt: skip
        run(["reconstruct", str(scan), "--calibration", str(out), "--edge", options.edge, "--contrast", "50",
             "--median", "0", "--method", options.method])  # fmt: skip
        _tell(name, options.folder, out, planes, given)


def _tell(name: str, folder: Path, out: Path, planes: Path, given: Path) -> None:
    made = json.loads(out.read_text())
    count = sum(plane is not None for plane in made["light_plane"]["planes"])
    skew = np.array([value for value in made["light_plane"]["quality"]["skew_mm"] if value is not None], np.float64)
    spreads, points = spread(folder, out, planes)
    print(
        f"{name}: {count} planes, skew {np.nanmedian(skew):.2f} mm (median), {np.nanmax(skew):.2f} mm at most, "
        f"{points} points"
    )
    for plane, found in spreads.items():
        print(
            f"  {plane}: {found.about_fit_mm:.2f} mm about its fit, {found.about_markers_mm:.2f} mm about the markers"
        )
    if given.exists():
        off = differences(made, json.loads(given.read_text()))
        middle, worst = np.median(off, axis=0), off.max(axis=0)
        print(f"  against the given planes: median {middle[0]:.3f} degrees and {middle[1]:.2f} mm, "
              f"worst {worst[0]:.3f} degrees and {worst[1]:.2f} mm")  # fmt: skip


if __name__ == "__main__":
    main()
