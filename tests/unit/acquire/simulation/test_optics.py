"""The simulated camera and projector against OpenCV and against the equations of the paper."""

import math

import cv2
import numpy as np
import pytest

from acquire.contract.config.simulation import SimulationConfig
from acquire.simulation.optics import lit_fraction, lit_interval, paper_camera, paper_projector

UM_PER_MICROSTEP = 3.175


@pytest.fixture
def projector():
    return paper_projector(SimulationConfig(), UM_PER_MICROSTEP)


def on_floor(projector, x, y):
    """Where the ray from the apex through (x, y), in units of the slide's radius about its corner, meets z = 0."""
    axis, edge, apex = np.array(projector.axis), np.array(projector.edge), np.array(projector.apex_mm)
    across = -np.array(projector.normal)
    ray = axis + projector.radius_ratio * (x * across + y * edge)
    return apex - ray * apex[2] / ray[2]


def test_opencv_projects_each_point_of_a_ray_onto_its_pixel():
    camera = paper_camera(SimulationConfig(distortion=(-0.3, 5.0, 1e-3, -2e-3, 0.0)), 64, 48)
    points = camera.centre_mm + 77 * camera.rays().reshape(-1, 3)
    rotation, _ = cv2.Rodrigues(camera.rotation)
    pixels, _ = cv2.projectPoints(points, rotation, camera.translation, camera.matrix, camera.distortion)
    columns, rows = np.meshgrid(np.arange(64), np.arange(48))
    np.testing.assert_allclose(pixels.reshape(48, 64, 2), np.stack([columns, rows], axis=-1), atol=1e-6)


def test_the_camera_looks_down_on_a_field_of_the_papers_size():
    camera = paper_camera(SimulationConfig(), 1024, 768)
    rays = camera.rays()
    floor = camera.centre_mm - rays * (camera.centre_mm[2] / rays[..., 2:])
    assert np.ptp(floor[384, :, 0]) == pytest.approx(6.8, abs=0.1)
    assert np.ptp(floor[:, 512, 1]) == pytest.approx(5.1, abs=0.1)
    assert np.abs(floor[383:385, 511:513].mean(axis=(0, 1))).max() < 0.01
    assert floor[384, -1, 0] > floor[384, 0, 0]
    assert floor[0, 512, 1] > floor[-1, 512, 1]


def test_a_smaller_picture_shows_the_same_field_with_larger_pixels():
    large, small = (paper_camera(SimulationConfig(), 1024 // n, 768 // n) for n in (1, 8))
    blocks = large.rays().reshape(96, 8, 128, 8, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(small.rays(), blocks, atol=2e-6)


def test_equations_9_and_10_give_the_apex_and_the_normal_of_the_plane(projector):
    corner, edge_end = on_floor(projector, 0, 0), on_floor(projector, 0, 1)
    np.testing.assert_allclose(corner, projector.corner_mm, atol=1e-9)
    from_corner = np.array(projector.apex_mm) - corner
    assert np.linalg.norm(from_corner) == pytest.approx(50.0**2 / 102.32, rel=1e-9)
    normal = np.cross(from_corner, edge_end - corner)
    np.testing.assert_allclose(np.abs(normal / np.linalg.norm(normal)), np.abs(projector.normal), atol=1e-9)


def test_the_straight_edge_across_the_tilt_is_as_long_as_equation_5_says(projector):
    length = np.linalg.norm(on_floor(projector, 1, 0) - on_floor(projector, 0, 0))
    alpha, theta = math.atan(3.81 / 50), math.acos(-projector.axis[2])
    pattern_radius_mm = 3.81 * 50 / 102.32
    assert length == pytest.approx(math.cos(alpha) / math.cos(theta - alpha) * pattern_radius_mm, rel=2e-3)


def test_a_microstep_moves_the_whole_projector_by_its_exact_length(projector):
    assert np.linalg.norm(projector.step_mm) == pytest.approx(UM_PER_MICROSTEP / 1000, rel=1e-12)


@pytest.mark.parametrize(("sigmas", "share"), [(-2, 0.02275), (-1, 0.15866), (0, 0.5), (1, 0.84134), (2, 0.97725)])
def test_the_light_edge_is_an_error_function_along_the_travel(projector, sigmas, share):
    position = 500.0
    at = np.array(projector.corner_mm) + 500 * np.array(projector.step_mm) + 0.7 * np.array(projector.edge)
    lit = lit_fraction(projector, *at, position + sigmas * 12.0, 12.0)
    assert lit == pytest.approx(share, abs=1e-4)


def test_light_ends_at_all_three_edges_of_the_quarter_circle(projector):
    inside = np.array([[0.3, 0.3], [0.1, 0.9], [0.9, 0.1]])
    outside = np.array([[-0.1, 0.3], [0.3, -0.1], [0.8, 0.8]])
    assert all(lit_fraction(projector, *on_floor(projector, x, y), 0.0, 1.0) > 0.999 for x, y in inside)
    assert all(lit_fraction(projector, *on_floor(projector, x, y), 0.0, 1.0) < 0.001 for x, y in outside)


def test_the_interval_of_full_light_is_fully_lit_inside_and_not_outside(projector):
    point, width = on_floor(projector, 0.3, 0.5), 12.0
    crossing = (point - np.array(projector.corner_mm)) @ np.array(projector.normal) / projector.normal_step_mm
    first, last = lit_interval(projector, *point, crossing, width, 5.0)
    assert first < 0 < last
    assert min(lit_fraction(projector, *point, at, width) for at in np.linspace(first, last, 50)) > 1 - 1e-5
    dark_first, dark_last = lit_interval(projector, *point, crossing, width, -5.0)
    assert max(lit_fraction(projector, *point, at, width) for at in (dark_first - 1, dark_last + 1)) < 1e-5
    assert dark_first < first
    assert last < dark_last


def test_a_point_that_the_pattern_never_reaches_has_no_interval(projector):
    far = np.array(projector.corner_mm) - 4 * np.array(projector.edge)
    first, last = lit_interval(projector, *far, 0.0, 12.0, -5.0)
    assert first > last
