"""Are the standard deviations of a light plane honest? `python -m tests.accuracy.uncertainty [--seeds 60]`.

Corners with noise calibrate a camera, then place three boards, whose pixels tell the plane: nothing is rendered. The
errors against truth are compared with the covariance that each calibration prints.
"""

from __future__ import annotations

import argparse

import cv2
import numpy as np

from acquire.contract.calibration import CameraModel
from acquire.contract.messages import FrameFormat
from process.calibration.boards import Sighting
from process.calibration.bundle import as_vector, fit_camera, joint_covariance
from process.calibration.plane_sweep import PlaneResult, fit_plane
from process.calibration.poses import Pose, find_pose, project
from process.calibration.surfaces import Surface
from process.calibration.sweeps import FoldedSweep
from process.geometry import rays

SIZE = (96, 72)
MATRIX = np.array([[280.0, 0, 50.0], [0, 280.0, 34.0], [0, 0, 1.0]])
DISTORTION = np.array([-0.3, 0.0, 0.0, 0.0, 0.0])
DISTANCE_MM = 20.0
VIEWS = ((0, 1.2), (20, 0), (-20, 3), (2, 22), (0, -21), (15, 15), (-16, 14), (10, -18))
SWEEPS = ((0, 0), (10, 2), (-9, 5))
CORNER_NOISE_PX = 0.02
CROSSING_NOISE = 0.05
A, B = np.array([10.0, 0.3, 16.0]), 45.0
"""The true plane: t = A . X + B."""
CORNERS = np.stack(np.meshgrid(np.arange(11) * 0.5 - 2.5, np.arange(9) * 0.5 - 2.0), axis=-1).reshape(-1, 2)


def pose(tilt: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    rotation = cv2.Rodrigues(np.radians([*tilt, 3.0]))[0] @ np.diag([1.0, -1.0, -1.0])
    return rotation, np.array([0.05, 0.1, DISTANCE_MM])


def see(tilt: tuple[float, float], generator: np.random.Generator) -> Sighting:
    rotation, shift = pose(tilt)
    exact = project(
        np.column_stack([CORNERS, np.zeros(len(CORNERS))]),
        cv2.Rodrigues(rotation)[0].ravel(),
        shift,
        MATRIX,
        DISTORTION,
    )
    return Sighting(exact + generator.normal(0, CORNER_NOISE_PX, exact.shape), CORNERS, True, 7.0)


def model(matrix: np.ndarray, distortion: np.ndarray, rotation: np.ndarray, shift: np.ndarray) -> CameraModel:
    return CameraModel(
        width=SIZE[0],
        height=SIZE[1],
        K=tuple(map(tuple, matrix.tolist())),
        R=tuple(map(tuple, rotation.tolist())),
        T=tuple(shift.tolist()),
        distortion=tuple(distortion.tolist()),
    )


def swept(tilt: tuple[float, float], camera: CameraModel, generator: np.random.Generator) -> Surface:
    """A sweep over a board that ``camera`` places by its corners; the light comes where it truly does."""
    view = see(tilt, generator)
    found = find_pose(view.object_mm, view.pixels, np.array(camera.K), np.array(camera.distortion))
    rotation, shift = pose(tilt)
    true = model(MATRIX, DISTORTION, *pose(VIEWS[0]))
    to_world, light = np.array(true.R).T, rays(true)
    point, normal = to_world @ (shift - np.array(true.T)), (to_world @ rotation)[:, 2]
    distance = (normal @ (point - light.centre_mm)) / (light.directions @ normal)
    crossing = (light.centre_mm + distance[:, None] * light.directions) @ A + B
    crossing += generator.normal(0, CROSSING_NOISE, len(crossing))
    shape = (SIZE[1], SIZE[0])
    sweep = FoldedSweep(
        str(tilt), crossing.reshape(shape), np.full(shape, CROSSING_NOISE), np.zeros(shape, np.uint8),
        np.arange(1000.0), "frame", None, FrameFormat(*SIZE, 8),
    )  # fmt: skip
    own = np.array(camera.R).T
    return Surface(
        sweep, own @ (found.translation - np.array(camera.T)), (own @ found.rotation)[:, 2], np.arange(len(crossing)),
        sighting=view, pose=found,
    )  # fmt: skip


def calibrated(seed: int) -> tuple[PlaneResult, np.ndarray]:
    """A light plane from noisy corners and crossings, and its error in (a, b), [4]."""
    generator = np.random.default_rng(seed)
    views = [see(tilt, generator) for tilt in VIEWS]
    fit = fit_camera(views, SIZE, "k1")
    stage: Pose = find_pose(views[0].object_mm, views[0].pixels, fit.matrix, fit.distortion)
    known = joint_covariance(fit, views[0], as_vector(stage))
    camera = model(fit.matrix, fit.distortion, stage.rotation, stage.translation)
    surfaces = [swept(tilt, camera, generator) for tilt in SWEEPS]
    result = fit_plane(surfaces, camera, edge="rising", method="auto", known_camera=known)
    return result, np.append(result.a - A, result.b - B)


def figures(seeds: range) -> dict[str, float]:
    """Root mean square errors beside the standard deviations that were printed, and the mean chi squared of a."""
    rows = []
    for seed in seeds:
        result, error = calibrated(seed)
        across = (np.eye(3) - np.outer(result.normal, result.normal)) @ error[:3] * result.speed_mm
        chi2 = error[:3] @ np.linalg.solve(result.spread.total[:3, :3], error[:3])
        speed = result.speed_mm * float(np.linalg.norm(A)) - 1
        rows.append((np.degrees(np.linalg.norm(across)), result.normal_sd_deg, speed, result.speed_sd, chi2))
    found = np.array(rows)
    rms = np.sqrt((found**2).mean(axis=0))
    return {
        "normal_error_deg": rms[0],
        "normal_sd_deg": rms[1],
        "speed_error_percent": 100 * rms[2],
        "speed_sd_percent": 100 * rms[3],
        "chi_squared_per_degree_of_freedom": found[:, 4].mean() / 3,
    }


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=60)
    for name, value in figures(range(parser.parse_args().seeds)).items():
        print(f"{name} {value:.4f}")


if __name__ == "__main__":
    main()
