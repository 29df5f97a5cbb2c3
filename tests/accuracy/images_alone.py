"""Remakes the table "everything from images alone" of docs/accuracy.md: `python -m tests.accuracy.images_alone DIR`.

Board views and sweeps over the board make the calibration, then objects are swept and compared with their truth,
without alignment. What is in DIR already is taken from there. Takes about five minutes for one seed.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import cv2
import h5py
import msgspec
import numpy as np

from acquire.contract.calibration import load_calibration
from acquire.contract.config.simulation import SimulationConfig
from process.cloud.cloud import LEFT_OUT
from process.cloud.light_planes import planes_at
from process.cloud.triangulation import rays
from process.crossings.quality import Quality
from tests.fakes.scans.simulated_scans import plan_of, simulate_sweep
from tui.cli import run

from .calibration import NOISE, SIZE, photograph

CONTRAST = 70
NEAR_EDGE_PX = 3
JUMP_MM = 0.01
"""Two neighbouring points that lie further than this off each other's tangent plane belong to an occluding edge."""


@dataclass(frozen=True)
class Measured:
    """Errors of one scan against its truth."""

    name: str
    wanted: int
    """Pixels that truth calls visible with the contrast, and more than 3 px from an occluding edge."""
    share: float
    """Of them, with a point."""
    median_um: float
    rms_um: float
    p95_um: float
    worst_bias_um: float
    """Longest mean error of the 8 parts of the volume."""
    bits: dict[str, int]
    """The rest of the wanted ones by quality bit."""
    near_edges: int
    """Points nearer to an occluding edge, which are in no other figure."""


def occluding_edges(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """[h, w] bool: pixels on either side of a jump in depth, or with no surface beside them."""
    edge = np.zeros(points.shape[:2], np.bool_)
    for axis in (0, 1):
        first, second = (np.moveaxis(a, axis, 0) for a in (points, normals))
        step = first[1:] - first[:-1]
        apart = [np.abs((step * n).sum(axis=-1)) for n in (second[1:], second[:-1])]
        jump = ~(np.minimum(*apart) < JUMP_MM)
        marked = np.moveaxis(edge, axis, 0)
        marked[1:] |= jump
        marked[:-1] |= jump
    return edge


def points_of(results: Path, calibration: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points [h, w, 3] in mm of maps.h5, which of them are in the cloud, and the quality bits."""
    with h5py.File(results / "maps.h5") as file:
        crossing, quality = file["crossing"][()], file["quality"][()]
    found = load_calibration(calibration)[0]
    plane, view = found.light_plane, rays(found.camera)
    assert plane is not None
    plan = plan_of()
    t = crossing + 1 if plane.parameter == "frame" else crossing * plan.pitch_steps * plan.um_per_microstep
    at = planes_at(plane, t.ravel())
    distance = (at[:, 3] - at[:, :3] @ view.centre_mm) / (at[:, :3] * view.directions).sum(axis=1)
    points = view.centre_mm + distance[:, None] * view.directions
    return points.reshape(*crossing.shape, 3), np.isfinite(crossing) & ((quality & LEFT_OUT) == 0), quality


def measure(folder: Path, calibration: Path, results: Path) -> Measured:
    """Compare the points of maps.h5 in ``results`` with truth.h5 in ``folder``."""
    with h5py.File(folder / "truth.h5") as file:
        truth, normals = file["points"][()], file["normals"][()]
        wanted = (file["visible"][()] > 0) & (file["amplitude"][()] >= CONTRAST)
    points, good, quality = points_of(results, calibration)
    error = points - truth
    away = cv2.distanceTransform((~occluding_edges(truth, normals)).astype(np.uint8), cv2.DIST_L2, 5) > NEAR_EDGE_PX
    wanted &= away
    used = wanted & good
    size_um = np.linalg.norm(error[used], axis=1) * 1000
    rest = quality[wanted & ~good]
    bits = {str(bit.name).lower(): int(((rest & bit) != 0).sum()) for bit in Quality}
    return Measured(
        name=folder.name,
        wanted=int(wanted.sum()),
        share=float(used.sum() / wanted.sum()),
        median_um=float(np.median(size_um)),
        rms_um=float(np.sqrt(np.mean(size_um**2))),
        p95_um=float(np.percentile(size_um, 95)),
        worst_bias_um=worst_bias_um(truth[used], error[used]),
        bits={name: count for name, count in bits.items() if count},
        near_edges=int((good & np.isfinite(truth[..., 0]) & ~away).sum()),
    )


def compare(name: str, step: Path, fly: Path, calibration: Path) -> None:
    """Prints by how much the points of two sweeps with the same noise differ."""
    (one, good, _), (other, also_good, _) = points_of(step, calibration), points_of(fly, calibration)
    apart = (other - one)[good & also_good] * 1000
    size = np.linalg.norm(apart, axis=1)
    print(
        f"{name}, fly against step: mean {np.linalg.norm(apart.mean(axis=0)):.3f} um, "
        f"median {np.median(size):.3f} um, 95 % below {np.percentile(size, 95):.3f} um",
        flush=True,
    )


def worst_bias_um(points: np.ndarray, error: np.ndarray) -> float:
    """Length of the longest mean error of the 8 parts that the middle of the points' range cuts the volume into."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    part = ((points > middle) @ np.array([1, 2, 4])).astype(int)
    means = [error[part == k].mean(axis=0) for k in range(8) if (part == k).sum() >= 100]
    return float(max(np.linalg.norm(mean) for mean in means) * 1000)


def calibrate(folder: Path, board: SimulationConfig, method: str) -> Path:
    """calibration.json of the folder, made from pictures of the board if it is not there."""
    calibration, camera = folder / "calibration.json", folder / "camera.json"
    if calibration.exists():
        return calibration
    photograph(folder / "views", board)
    sweeps = []
    for name, tilt in (("flat", 0.0), ("tilted", 10.0), ("tilted-back", -10.0)):
        sweeps.append(str(folder / name))
        if not (folder / name / "scan.h5").exists():
            simulate_sweep(folder / name, msgspec.structs.replace(board, tilt_x_deg=tilt), size=SIZE)
    squares = f"{board.board_columns}x{board.board_rows}"
    pattern = ["--squares", squares, "--square-mm", str(board.board_square_mm), "--force"]
    run(["calibrate", "camera", str(folder / "views"), *pattern, "--stage", "00.png", "--out", str(camera)])
    plane = ["--camera", str(camera), "--out", str(calibration), "--method", method]
    run(["calibrate", "plane", *sweeps, *pattern, *plane])
    return calibration


def main() -> None:
    """Prints one row for each object and seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--squares", default="41x31")
    parser.add_argument("--square-mm", type=float, default=0.15)
    parser.add_argument("--method", default="auto")
    parser.add_argument("--objects", nargs="+", default=["dome", "stirrup"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    parser.add_argument("--fly", action="store_true", help="also with the stage moving during the exposure")
    options = parser.parse_args()
    columns, rows = (int(part) for part in options.squares.split("x"))
    board = SimulationConfig(
        object="checkerboard", colour=False, board_columns=columns, board_rows=rows,
        board_square_mm=options.square_mm, read_noise_counts=NOISE, full_well_electrons=0.0,
    )  # fmt: skip
    options.folder.mkdir(parents=True, exist_ok=True)
    calibration = calibrate(options.folder, board, options.method)
    print("| object | wanted pixels | with a point | median um | RMS um | 95 % um | worst bias um | the rest by bit |")
    print("| --- " * 8 + "|")
    for name in options.objects:
        for seed in options.seeds:
            thing = msgspec.structs.replace(board, object=name, seed=seed)
            scan = options.folder / (name if seed == 1 else f"{name}-{seed}")
            step = one(scan, thing, calibration, options.method, fly=False)
            if options.fly:
                fly = one(scan.with_name(f"{scan.name}-fly"), thing, calibration, options.method, fly=True)
                compare(scan.name, step, fly, calibration)


def one(scan: Path, thing: SimulationConfig, calibration: Path, method: str, *, fly: bool) -> Path:
    """Sweep an object if that was not done, reconstruct, print a row; returns the folder of the results."""
    if not (scan / "truth.h5").exists():
        simulate_sweep(scan, thing, size=SIZE, with_truth=True, travel_share=0.9 if fly else 0.0)
    results = scan / f"results-{method}"
    run(["reconstruct", str(scan), "--calibration", str(calibration), "--method", method, "--out", str(results)])
    show(measure(scan, calibration, results))
    return results


def show(row: Measured) -> None:
    """One line of the table."""
    bits = ", ".join(f"{name} {count}" for name, count in row.bits.items())
    print(
        f"| {row.name} | {row.wanted} | {100 * row.share:.2f} % | {row.median_um:.2f} | {row.rms_um:.2f} "
        f"| {row.p95_um:.2f} | {row.worst_bias_um:.2f} | {bits or 'none'} |",
        flush=True,
    )


if __name__ == "__main__":
    main()
