"""Are the standard deviations of a light plane honest? `python -m tests.accuracy.uncertainty [--seeds 60]`.

Corners with noise calibrate a camera, then place three boards that lie as well as boards lie, whose pixels tell the
plane, with an error in common: nothing is rendered. The errors against truth are compared with the covariance that each
calibration prints. Once with a board that fills a coarse picture, once with the paper's small one under its nearly
telecentric camera.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import cv2
import numpy as np

from acquire.contract.calibration import CameraModel
from acquire.contract.messaging.messages import FrameFormat
from process.calibration.board.detection import Sighting
from process.calibration.board.poses import PlanePose, find_pose, project
from process.calibration.camera.bundle import CameraFit, as_vector, fit_camera, joint_covariance
from process.calibration.light_plane.edge_on_surface import COMMON_FLOOR_FRAMES
from process.calibration.light_plane.from_sweeps import PlaneResult, fit_plane
from process.calibration.light_plane.joint_residuals import FLAT_BOARD_SD_MM, FLAT_BOARD_SD_RAD
from process.calibration.light_plane.surfaces import Surface
from process.calibration.light_plane.sweeps import FoldedSweep
from process.calibration.light_plane.uncertainty import HEIGHTS_MM
from process.cloud.triangulation import rays

DISTORTION = np.array([-0.3, 0.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Rig:
    """A camera, a board, how it is shown to it, and a plane of light t = a . X + b."""

    size: tuple[int, int]
    focal_px: float
    centre_px: tuple[float, float]
    distance_mm: float
    corners: tuple[int, int]
    pitch_mm: float
    views: tuple[tuple[float, float], ...]
    sweeps: tuple[tuple[float, float], ...]
    corner_noise_px: float
    crossing_noise: float
    """In t, which is in frames."""
    a: tuple[float, float, float]
    b: float
    stage_deg: tuple[float, float] = (0.0, 1.2)
    """How the stage lies before the camera; tilts of the sweeps' boards are against it."""

    @property
    def matrix(self) -> np.ndarray:
        return np.array([[self.focal_px, 0, self.centre_px[0]], [0, self.focal_px, self.centre_px[1]], [0, 0, 1.0]])

    @property
    def board_mm(self) -> np.ndarray:
        """[n, 2] about the middle."""
        x, y = (np.arange(count) * self.pitch_mm - (count - 1) * self.pitch_mm / 2 for count in self.corners)
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)

    def pose(self, tilt: tuple[float, float], lift_mm: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Of a board that is tilted against the stage, and lifted towards the camera."""
        turn = [self.stage_deg[0] + tilt[0], self.stage_deg[1] + tilt[1], 3.0]
        rotation = cv2.Rodrigues(np.radians(turn))[0] @ np.diag([1.0, -1.0, -1.0])
        at_middle = np.linalg.solve(self.matrix, [(self.size[0] - 1) / 2, (self.size[1] - 1) / 2, 1.0])
        return rotation, at_middle * self.distance_mm + np.array([0.05, 0.1, -lift_mm])

    def camera(self) -> CameraModel:
        """The true one."""
        return model(self.size, self.matrix, DISTORTION, *self.pose((0.0, 0.0)))


COARSE = Rig(
    size=(96, 72), focal_px=280.0, centre_px=(50.0, 34.0), distance_mm=20.0, corners=(11, 9), pitch_mm=0.5,
    views=((0, 0), (20, -1), (-20, 2), (2, 21), (0, -22), (15, 14), (-16, 13), (10, -19)),
    sweeps=((0, 0), (10, 1), (-9, 4)), corner_noise_px=0.02, crossing_noise=0.05, a=(10.0, 0.3, 16.0), b=45.0,
)  # fmt: skip
SMALL = Rig(
    size=(256, 256), focal_px=11_560.0, centre_px=(308.0, 336.0), distance_mm=76.9, corners=(12, 12), pitch_mm=0.1,
    views=((0, 0), (20, 0), (-20, 0), (0, 20), (0, -20), (14, 14), (14, -14), (-14, 14), (-14, -14), (25, 5), (-5, 25),
           (8, -8), (-9, -3), (5, 12), (-24, 8)),
    sweeps=((0, 0), (10, 0), (-10, 0)), corner_noise_px=0.015, crossing_noise=0.06, a=(57.4, -0.6, 88.0), b=260.0,
    stage_deg=(-1.2, 1.2),
)  # fmt: skip


TILTS: tuple[tuple[tuple[float, float], ...], ...] = (
    ((0, 0), (10, 0)), ((0, 0), (5, 0), (-5, 0)), ((0, 0), (10, 0), (-10, 0)), ((0, 0), (20, 0), (-20, 0)),
    ((0, 0), (20, 0), (0, 20)), ((10, 0), (-10, 0)), ((20, 0), (-20, 0), (0, 20), (0, -20)),
)  # fmt: skip
"""Sets of sweeps whose worth is of interest: with a flat one, and without."""


def see(rig: Rig, tilt: tuple[float, float], generator: np.random.Generator, lift_mm: float = 0.0) -> Sighting:
    rotation, shift = rig.pose(tilt, lift_mm)
    places = np.column_stack([rig.board_mm, np.zeros(len(rig.board_mm))])
    exact = project(places, cv2.Rodrigues(rotation)[0].ravel(), shift, rig.matrix, DISTORTION)
    return Sighting(exact + generator.normal(0, rig.corner_noise_px, exact.shape), rig.board_mm, True, 7.0)


def model(
    size: tuple[int, int], matrix: np.ndarray, distortion: np.ndarray, rotation: np.ndarray, shift: np.ndarray
) -> CameraModel:
    return CameraModel(
        width=size[0],
        height=size[1],
        K=tuple(map(tuple, matrix.tolist())),
        R=tuple(map(tuple, rotation.tolist())),
        T=tuple(shift.tolist()),
        distortion=tuple(distortion.tolist()),
    )


def swept(rig: Rig, tilt: tuple[float, float], camera: CameraModel, generator: np.random.Generator) -> Surface:
    """A sweep over a board that ``camera`` places by its corners; the light comes where it truly does."""
    tilt = (
        tilt[0] + generator.normal(0, np.degrees(FLAT_BOARD_SD_RAD)),
        tilt[1] + generator.normal(0, np.degrees(FLAT_BOARD_SD_RAD)),
    )
    lift_mm = generator.normal(0, FLAT_BOARD_SD_MM)
    view = see(rig, tilt, generator, lift_mm)
    found = find_pose(view.object_mm, view.pixels, np.array(camera.K), np.array(camera.distortion))
    rotation, shift = rig.pose(tilt, lift_mm)
    true = rig.camera()
    to_world, light = np.array(true.R).T, rays(true)
    point, normal = to_world @ (shift - np.array(true.T)), (to_world @ rotation)[:, 2]
    distance = (normal @ (point - light.centre_mm)) / (light.directions @ normal)
    x = light.centre_mm + distance[:, None] * light.directions
    shape, at = (rig.size[1], rig.size[0]), (x - point) @ (to_world @ rotation)[:, :2]
    seen = np.abs(at).max(axis=1) < rig.board_mm.max() + rig.pitch_mm
    crossing = x @ rig.a + rig.b + generator.normal(0, rig.crossing_noise, len(x)) + in_common(at, seen, generator)
    sweep = FoldedSweep(
        str(tilt), crossing.reshape(shape), np.full(shape, rig.crossing_noise), np.zeros(shape, np.uint8),
        np.arange(1000.0), "frame", None, FrameFormat(*rig.size, 8),
    )  # fmt: skip
    own = np.array(camera.R).T
    return Surface(
        sweep, own @ (found.translation - np.array(camera.T)), (own @ found.rotation)[:, 2],
        np.flatnonzero(seen), sighting=view, pose=found,
    )  # fmt: skip


def in_common(at: np.ndarray, seen: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """[n] an error that all pixels of a surface have in common: a plane over it, ``at`` [n, 2] mm."""
    corners = np.array([[1.0, 0.0, -1.4], [1.0, -1.2, 0.7], [1.0, 1.2, 0.7]])
    plane = np.linalg.solve(corners, generator.normal(0, COMMON_FLOOR_FRAMES, 3))
    middle, size = at[seen].mean(axis=0), at[seen].std(axis=0)
    return np.column_stack([np.ones(len(at)), (at - middle) / size]) @ plane


def truth(rig: Rig) -> CameraFit:
    """Where a fit of the camera may begin: it ends where the corners are."""
    optics = np.array([rig.focal_px, rig.focal_px, *rig.centre_px, *DISTORTION])
    poses = [(cv2.Rodrigues(rotation)[0].ravel(), shift) for rotation, shift in map(rig.pose, rig.views)]
    return CameraFit(optics, tuple(map(np.concatenate, poses)), np.zeros((9, 9)), 0.0, (), "k1")


def measured(rig: Rig, seed: int) -> tuple[list[Surface], CameraModel, np.ndarray]:
    """Swept boards, a camera from noisy corners, and its covariance [15, 15]."""
    generator = np.random.default_rng(seed)
    views = [see(rig, tilt, generator) for tilt in rig.views]
    fit = fit_camera(views, rig.size, "k1", start=truth(rig))
    stage: PlanePose = find_pose(views[0].object_mm, views[0].pixels, fit.matrix, fit.distortion)
    known = joint_covariance(fit, views[0], as_vector(stage))
    camera = model(rig.size, fit.matrix, fit.distortion, stage.rotation, stage.translation)
    return [swept(rig, tilt, camera, generator) for tilt in rig.sweeps], camera, known


def calibrated(rig: Rig, seed: int) -> PlaneResult:
    """A light plane from these."""
    surfaces, camera, known = measured(rig, seed)
    return fit_plane(surfaces, camera, edge="rising", method="auto", known_camera=known)


def point_errors_um(rig: Rig, result: PlaneResult) -> np.ndarray:
    """[heights, 4] of the points at the corners of the picture, at each of HEIGHTS_MM."""
    corners = np.array([[x, y] for x in (0.0, rig.size[0] - 1.0) for y in (0.0, rig.size[1] - 1.0)])
    true, found = rays(rig.camera(), corners), rays(result.camera, corners)
    errors = []
    for height in HEIGHTS_MM:
        away = (height - true.centre_mm[2]) / true.directions[:, 2]
        x = true.centre_mm + away[:, None] * true.directions
        t = x @ rig.a + rig.b
        reach = (t - result.b - found.centre_mm @ result.a) / (found.directions @ result.a)
        errors.append(1000 * np.linalg.norm(found.centre_mm + reach[:, None] * found.directions - x, axis=1))
    return np.array(errors)


def figures(rig: Rig, seeds: range) -> dict[str, float]:
    """Root mean square errors beside the standard deviations that were printed, and the mean chi squared of a."""
    rows, points, a = [], [], np.array(rig.a)
    for seed in seeds:
        result = calibrated(rig, seed)
        error = result.a - a
        across = (np.eye(3) - np.outer(result.normal, result.normal)) @ error * result.speed_mm
        chi2 = error @ np.linalg.solve(result.spread.total[:3, :3], error)
        speed = result.speed_mm * float(np.linalg.norm(a)) - 1
        rows.append([
            np.degrees(np.linalg.norm(across)), result.normal_sd_deg, speed, result.speed_sd, np.sqrt(chi2 / 3),
            *result.predicted_um,
        ])  # fmt: skip
        points.append(point_errors_um(rig, result))
    rms, worst = (np.sqrt((np.array(found) ** 2).mean(axis=0)) for found in (rows, points))
    return {
        "normal_error_deg": rms[0],
        "normal_sd_deg": rms[1],
        "speed_error_percent": 100 * rms[2],
        "speed_sd_percent": 100 * rms[3],
        "chi_squared_per_degree_of_freedom": rms[4] ** 2,
        "point_error_um_on_the_stage": worst[0].max(),
        "point_error_um_half_a_mm_above": worst[1].max(),
        "point_predicted_um_on_the_stage": rms[5],
        "point_predicted_um_half_a_mm_above": rms[6],
    }


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--tilts", action="store_true", help="what other sweeps over the small board would be worth")
    options = parser.parse_args()
    seeds = range(options.seeds)
    rigs = {"a board that fills a coarse picture": COARSE, "the paper's small board": SMALL}
    if options.tilts:
        rigs = {f"small board, tilts {sweeps}": replace(SMALL, sweeps=sweeps) for sweeps in TILTS}
    for name, rig in rigs.items():
        print(name)
        for what, value in figures(rig, seeds).items():
            print(f"  {what} {value:.4f}")


if __name__ == "__main__":
    main()
