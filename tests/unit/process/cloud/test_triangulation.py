"""Rays, planes and their intersection, checked against projections made by OpenCV and by hand."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from acquire.contract.calibration import CameraModel, PerFramePlanes, TranslatingPlane
from acquire.contract.errors import CalibrationError
from process.cloud.light_planes import coordinates, plane_table, planes_at
from process.cloud.triangulation import Hits, intersect, rays

WIDTH, HEIGHT = 64, 48
ROTATION = cv2.Rodrigues(np.array([np.pi - 0.05, 0.03, 0.02]))[0]
CAMERA = CameraModel(
    width=WIDTH,
    height=HEIGHT,
    K=((700.0, 0.0, 31.0), (0.0, 705.0, 24.5), (0.0, 0.0, 1.0)),
    R=tuple(tuple(row) for row in ROTATION.tolist()),
    T=(0.3, -0.2, 77.0),
    distortion=(-0.3, 0.05, 0.001, -0.002, 0.0),
)
PLANE = TranslatingPlane(
    parameter="frame",
    normal=(-0.546, -0.0055, 0.838),
    corner_origin_mm=(0.3, 0.1, 0.0),
    corner_velocity_mm=(-0.0094, 0.0001, 0.0),
)
PER_FRAME = PerFramePlanes(
    parameter="frame", first_frame=3, planes=((-0.5, 0.0, 0.8, 0.1), (-0.6, 0.1, 0.8, 0.2), (-0.4, 0.0, 1.6, -0.3))
)


def hits(pixels, crossing, sigma=0.1) -> Hits:
    pixels = np.asarray(pixels, dtype=np.intp)
    return Hits(pixels, np.broadcast_to(np.float64(crossing), pixels.shape), np.full(len(pixels), sigma, np.float32))


def frame_t(frames: int) -> np.ndarray:
    return np.arange(1, frames + 1, dtype=np.float64)


def pinhole(width: int = 2, height: int = 1, **changes) -> CameraModel:
    fields = {
        "K": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        "R": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        "T": (0.0, 0.0, 0.0),
    }
    return CameraModel(width=width, height=height, **(fields | changes))


def test_a_point_along_a_ray_projects_back_onto_its_pixel():
    pixels = np.random.default_rng(1).uniform(0, HEIGHT, (200, 2))
    centre, directions = rays(CAMERA, pixels)
    points = centre + 70.0 * directions
    rotation, _ = cv2.Rodrigues(np.array(CAMERA.R))
    projected, _ = cv2.projectPoints(
        points, rotation, np.array(CAMERA.T), np.array(CAMERA.K), np.array(CAMERA.distortion)
    )
    assert np.abs(projected.reshape(-1, 2) - pixels).max() < 1e-8


def test_the_whole_image_has_its_rays_in_row_major_order_at_integer_centres():
    whole = rays(CAMERA)
    one = rays(CAMERA, np.array([[5.0, 2.0]]))
    assert whole.directions.shape == (WIDTH * HEIGHT, 3)
    assert np.allclose(whole.directions[2 * WIDTH + 5], one.directions[0], atol=1e-15)


def test_no_pixels_give_no_rays():
    assert rays(CAMERA, np.empty((0, 2))).directions.shape == (0, 3)


@pytest.mark.parametrize("plane", [PLANE, PER_FRAME])
def test_every_point_lies_on_its_ray_and_in_the_plane_of_its_crossing(plane):
    pixels = np.arange(WIDTH * HEIGHT)
    crossing = np.random.default_rng(2).uniform(2.0, 4.0, len(pixels))
    sigma = np.full(len(pixels), 0.1, np.float32)
    points, _ = intersect(rays(CAMERA), plane_table(plane), frame_t(10), Hits(pixels, crossing, sigma))
    planes = planes_at(plane, crossing + 1)
    centre, directions = rays(CAMERA)
    assert np.isfinite(points).all()
    assert np.abs((planes[:, :3] * points).sum(axis=1) - planes[:, 3]).max() < 1e-10
    assert np.abs(np.cross(points - centre, directions)).max() < 1e-10


@pytest.mark.parametrize("plane", [PLANE, PER_FRAME])
@pytest.mark.parametrize("direction", [1.0, -2.5])
def test_sigma_is_the_numerical_derivative_of_the_point_by_the_frame(plane, direction):
    positions = 100.0 + direction * frame_t(10) if plane is PLANE else frame_t(10)
    pixels, step = np.arange(0, WIDTH * HEIGHT, 37), 1e-5
    low, _ = intersect(rays(CAMERA), plane_table(plane), positions, hits(pixels, 3.3 - step))
    high, _ = intersect(rays(CAMERA), plane_table(plane), positions, hits(pixels, 3.3 + step))
    _, sigma_um = intersect(rays(CAMERA), plane_table(plane), positions, hits(pixels, 3.3, sigma=0.2))
    numerical_um = np.linalg.norm(high - low, axis=1) / (2 * step) * 0.2 * 1000
    assert np.allclose(sigma_um, numerical_um, rtol=1e-4)


def test_per_frame_planes_exist_from_the_first_to_the_last_frame_both_included():
    crossing = np.array([1.999999, 2.0, 4.0, 4.000001])
    found = planes_at(PER_FRAME, crossing + 1)
    points, _ = intersect(
        rays(CAMERA), plane_table(PER_FRAME), frame_t(9), Hits(np.zeros(4, np.intp), crossing, np.ones(4, np.float32))
    )
    assert np.isfinite(found[:, 0]).tolist() == [False, True, True, False]
    assert np.isfinite(points[:, 0]).tolist() == [False, True, True, False]
    assert np.allclose(found[1:3], [PER_FRAME.planes[0], PER_FRAME.planes[2]])


def test_a_single_per_frame_plane_serves_its_own_frame_only():
    single = PerFramePlanes(parameter="frame", first_frame=4, planes=((0.0, 0.0, 1.0, 0.0),))
    found = planes_at(single, np.array([3.5, 4.0, 4.5]))
    points, _ = intersect(rays(CAMERA), plane_table(single), frame_t(9), hits([7], 3.0))
    assert np.isfinite(found[:, 0]).tolist() == [False, True, False]
    assert abs(points[0, 2]) < 1e-12


def test_a_plane_behind_the_camera_gives_no_point():
    behind = TranslatingPlane("frame", (0.0, 0.0, 1.0), (0.0, 0.0, -5.0), (0.0, 0.0, 0.1))
    points, sigma_um = intersect(rays(pinhole()), plane_table(behind), frame_t(3), hits([0, 1], 1.0))
    assert np.isnan(points).all() and np.isnan(sigma_um).all()


def test_a_ray_parallel_to_the_plane_gives_no_point():
    parallel = TranslatingPlane("frame", (1.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.1, 0.0, 0.0))
    points, _ = intersect(rays(pinhole()), plane_table(parallel), frame_t(3), hits([0, 1], 1.0))
    assert np.isnan(points[0]).all(), "the ray of pixel 0 runs along z, within the plane's direction"
    assert np.isfinite(points[1]).all()


@pytest.mark.parametrize("crossing", [np.nan, -0.5, 2.0001, np.inf])
def test_a_crossing_outside_the_sweep_gives_no_point(crossing):
    points, _ = intersect(rays(CAMERA), plane_table(PLANE), frame_t(3), hits([0], crossing))
    assert np.isnan(points).all()


def test_frame_coordinates_count_from_one():
    assert coordinates(PLANE, 3, np.ones(3, bool), np.full(3, np.nan)).tolist() == [1.0, 2.0, 3.0]


def test_positions_of_missing_frames_are_interpolated_between_those_present():
    by_position = TranslatingPlane("position_um", PLANE.normal, PLANE.corner_origin_mm, PLANE.corner_velocity_mm)
    present = np.array([True, False, False, True])
    found = coordinates(by_position, 4, present, np.array([10.0, np.nan, 77.0, 40.0]))
    assert found.tolist() == [10.0, 20.0, 30.0, 40.0]


def test_a_plane_by_position_is_refused_where_positions_are_unknown():
    by_position = TranslatingPlane("position_um", PLANE.normal, PLANE.corner_origin_mm, PLANE.corner_velocity_mm)
    with pytest.raises(CalibrationError, match="does not know its positions"):
        coordinates(by_position, 2, np.ones(2, bool), np.full(2, np.nan))
