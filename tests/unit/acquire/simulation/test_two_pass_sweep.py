"""A simulated sweep reconstructed plainly by two passes, half brightness and a linear crossing, against its truth."""

import cv2
import numpy as np
import pytest

from acquire.contract.config.simulation import SimulationConfig
from acquire.contract.errors import ConfigError
from acquire.simulation import Renderer, build_scene, ideal_calibration, truth

CAMERA = {"exposure_ms": 30.0, "gain": 6.0, "brightness": 0.0}
SWEEP = {"first_steps": 0, "steps_per_frame": 3, "count": 527}
OBJECTS = ("stirrup", "dome", "wedge", "flat", "checkerboard")
NOISELESS = {"read_noise_counts": 0.0, "full_well_electrons": 0.0}


def scene_of(size=(128, 96), **config):
    config = SimulationConfig(**{"colour": False} | config)
    return build_scene(config, width=size[0], height=size[1], um_per_microstep=3.175)


def crossings(scene, first_steps, steps_per_frame, count):
    """Algorithms 1 to 3 of the paper on all frames at once; NaN below contrast 70."""
    renderer = Renderer(scene)
    positions = first_steps + steps_per_frame * np.arange(count)
    frames = np.array([renderer.render(position, **CAMERA) for position in positions])
    low, high = frames.min(axis=0).astype(int), frames.max(axis=0).astype(int)
    past = 2 * frames.astype(int) >= low + high
    index = np.maximum(past.argmax(axis=0), 1)
    before, after = (np.take_along_axis(frames, i[None], axis=0)[0].astype(float) for i in (index - 1, index))
    with np.errstate(divide="ignore", invalid="ignore"):
        found = index - 1 + ((low + high) / 2 - before) / (after - before)
    return np.where((high - low >= 70) & ~past[0], found, np.nan)


def intersect(calibration, crossing, position_um):
    """Equations 2 and 4 with OpenCV's own undistortion."""
    camera, plane = calibration["camera"], calibration["light_plane"]
    matrix, distortion, rotation, shift = (np.array(camera[key]) for key in ("K", "distortion", "R", "T"))
    columns, rows = np.meshgrid(np.arange(camera["width"], dtype=float), np.arange(camera["height"], dtype=float))
    flat = cv2.undistortPoints(np.stack([columns, rows], axis=-1).reshape(-1, 1, 2), matrix, distortion)
    rays = cv2.convertPointsToHomogeneous(flat)[:, 0] @ rotation
    origin, normal = -rotation.T @ shift, np.array(plane["normal"])
    travel = position_um.ravel()[:, None] * np.array(plane["corner_velocity_mm"])
    scale = ((np.array(plane["corner_origin_mm"]) + travel - origin) @ normal) / (rays @ normal)
    return (origin + scale[:, None] * rays).reshape(*crossing.shape, 3)


def test_the_true_crossing_is_the_one_that_is_found_without_noise():
    scene = scene_of(object="wedge", **NOISELESS)
    exact = truth(scene, **SWEEP)
    wrong = (crossings(scene, **SWEEP) - exact.crossing)[(exact.visible == 1) & (exact.amplitude >= 70)]
    assert abs(np.mean(wrong)) < 0.03
    assert np.abs(wrong).max() < 0.3


def errors_um(scene):
    """Distance from the truth of each visible pixel over the contrast, NaN where no crossing was found."""
    found, exact = crossings(scene, **SWEEP), truth(scene, **SWEEP)
    points = intersect(ideal_calibration(scene, **SWEEP), found, 3 * found * 3.175)
    target = (exact.visible == 1) & (exact.amplitude >= 70)
    return 1000 * np.linalg.norm(points - exact.points, axis=-1)[target], (points - exact.points)[target]


@pytest.mark.parametrize("name", OBJECTS)
def test_without_noise_points_lie_within_a_fifth_of_a_micrometre_in_the_mean(name):
    distance, offset = errors_um(scene_of(object=name, **NOISELESS))
    assert np.isfinite(distance).mean() > 0.99
    assert np.abs(1000 * np.nanmean(offset, axis=0)).max() < 0.2
    assert np.nanmedian(distance) < 0.3


@pytest.mark.parametrize("name", OBJECTS)
def test_with_noise_the_median_error_stays_under_a_micrometre(name):
    distance, _ = errors_um(scene_of(object=name))
    assert np.isfinite(distance).mean() > 0.9
    assert np.nanmedian(distance) < 1.0


def test_the_stirrup_shows_as_much_surface_as_the_paper_reports():
    exact = truth(scene_of(), **SWEEP)
    share = ((exact.visible == 1) & (exact.amplitude >= 70)).mean()
    assert 60_000 < share * 1024 * 768 < 90_000


def test_the_stirrup_is_dark_before_the_sweep_and_crossed_within_it():
    scene = scene_of()
    exact = truth(scene, **SWEEP)
    assert Renderer(scene).render(0, room=0.0, **CAMERA)[scene.on_object].max() <= 6
    assert np.nanmin(exact.crossing[scene.on_object]) > 5 * exact.edge_width.max()
    assert np.isfinite(exact.crossing[scene.on_object]).all()


def test_the_foil_stays_below_the_papers_contrast():
    scene = scene_of()
    assert truth(scene, **SWEEP).amplitude[~scene.on_object].max() < 50


def test_a_sweep_the_other_way_crosses_at_the_same_positions():
    scene = scene_of()
    forward, back = truth(scene, 0, 3, 527), truth(scene, 1578, -3, 527)
    np.testing.assert_allclose(526 - back.crossing, forward.crossing, atol=1e-9)
    np.testing.assert_array_equal(back.visible, forward.visible)


def test_a_rehoming_error_shifts_every_crossing_and_not_the_calibration():
    plain, shifted = scene_of(object="wedge"), scene_of(object="wedge", rehome_error_steps=30)
    moved = truth(plain, **SWEEP).crossing - truth(shifted, **SWEEP).crossing
    np.testing.assert_allclose(moved[np.isfinite(moved)], 10.0, atol=1e-9)
    assert ideal_calibration(plain, **SWEEP) == ideal_calibration(shifted, **SWEEP)
    frames = [Renderer(plain).render(630, **CAMERA), Renderer(shifted).render(600, **CAMERA)]
    assert np.abs(frames[0].astype(int) - frames[1]).max() < 25


def test_a_moved_specimen_moves_and_its_stage_does_not():
    plain, moved = scene_of(object="wedge"), scene_of(object="wedge", specimen_moved_um=(0.0, 0.0, 80.0))
    both = plain.on_object & moved.on_object
    np.testing.assert_allclose(np.median((moved.points_mm - plain.points_mm)[both][:, 2]), 0.080, atol=5e-3)
    neither = ~plain.on_object & ~moved.on_object
    np.testing.assert_array_equal(moved.points_mm[neither], plain.points_mm[neither])


def test_the_foil_behind_an_object_lies_in_its_shadow_and_is_not_visible():
    scene = scene_of(object="dome")
    exact = truth(scene, **SWEEP)
    x, y = scene.points_mm[..., 0], scene.points_mm[..., 1]
    beside = ~scene.on_object & (np.abs(y) < 0.1)
    behind, before = beside & (x > 1.16) & (x < 1.25), beside & (x < -0.6) & (x > -0.9)
    assert behind.any()
    assert not exact.visible[behind].any()
    assert exact.visible[before].all()
    assert exact.amplitude[behind].max() < 0.1 * exact.amplitude[before].min()


def test_a_sweep_that_ends_early_leaves_late_pixels_invisible():
    scene = scene_of(object="flat")
    whole, half = truth(scene, **SWEEP), truth(scene, 0, 3, 264)
    late = whole.crossing > 263
    assert whole.visible[late].any()
    assert not half.visible[late].any()
    assert np.isnan(half.crossing[late]).all()


@pytest.mark.parametrize("wrong", [{"count": 0}, {"steps_per_frame": 0}])
def test_the_truth_of_no_sweep_is_refused(wrong):
    with pytest.raises(ConfigError, match="it takes a sweep"):
        truth(scene_of(size=(16, 12)), **SWEEP | wrong)
