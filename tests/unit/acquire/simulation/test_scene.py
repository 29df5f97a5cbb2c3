"""Scenes, pictures, truth files and calibrations of the simulated rig."""

import json

import cv2
import h5py
import numpy as np
import pytest

from acquire.contract.calibration import parse_calibration
from acquire.contract.config.simulation import SimulationConfig
from acquire.contract.errors import ConfigError
from acquire.simulation import DEFAULT_CAMERA, Renderer, build_scene, ideal_calibration, truth, write_truth
from acquire.simulation.raycast import visible_share

CAMERA = {"exposure_ms": 30.0, "gain": 6.0, "brightness": 0.0}
NOISELESS = {"read_noise_counts": 0.0, "full_well_electrons": 0.0}


def scene_of(size=(64, 48), **config):
    return build_scene(SimulationConfig(**config), width=size[0], height=size[1], um_per_microstep=3.175)


def picture(scene, position=600, **change):
    return Renderer(scene).render(position, **CAMERA | change).astype(int)


def test_defaults_of_the_camera_are_those_that_the_scene_is_lit_for():
    assert (DEFAULT_CAMERA.exposure_ms, DEFAULT_CAMERA.gain, DEFAULT_CAMERA.brightness) == (30.0, 6.0, 0.0)


@pytest.mark.parametrize(
    ("config", "shape", "dtype"),
    [
        ({}, (48, 64, 3), np.uint8),
        ({"colour": False}, (48, 64), np.uint8),
        ({"bit_depth": 12}, (48, 64, 3), np.uint16),
    ],
)
def test_frames_have_the_shape_and_type_of_the_camera(config, shape, dtype):
    frame = Renderer(scene_of(**config)).render(600, **CAMERA)
    assert (frame.shape, frame.dtype) == (shape, dtype)


def test_twelve_bits_are_the_same_picture_in_finer_steps_and_saturate_at_4095():
    deep = picture(scene_of(bit_depth=12, **NOISELESS), exposure_ms=60.0)
    flat = picture(scene_of(**NOISELESS), exposure_ms=60.0)
    assert deep.max() == 4095
    assert np.abs(deep * 255 / 4095 - flat).max() <= 0.6


def test_the_same_seed_gives_the_same_picture_and_another_one_another_texture():
    first, same, other = (picture(scene_of(seed=seed, **NOISELESS)) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, same)
    assert (first != other).any()


def test_twice_the_exposure_or_six_decibels_are_twice_as_bright():
    scene = scene_of(bit_depth=16, **NOISELESS)
    single = picture(scene, exposure_ms=10.0)
    np.testing.assert_allclose(picture(scene, exposure_ms=20.0), 2 * single, atol=2)
    np.testing.assert_allclose(picture(scene, exposure_ms=10.0, gain=6 + 20 * np.log10(2)), 2 * single, atol=2)


def test_brightness_lifts_the_black_level_in_percent_of_full_scale():
    scene = scene_of(**NOISELESS)
    assert picture(scene, lamp=0.0, room=0.0, brightness=20.0).min() == 51


def test_without_the_lamp_only_the_room_is_left_and_the_two_add():
    scene = scene_of(bit_depth=16, **NOISELESS)
    room, lamp, both = (
        picture(scene, exposure_ms=15.0, **off) for off in ({"lamp": 0.0}, {"room": 0.0}, {"gain": 6.0})
    )
    assert room.max() > 0
    np.testing.assert_allclose(room + lamp, both, atol=1)


def test_motion_during_the_exposure_is_the_mean_over_its_positions():
    scene = scene_of(object="flat", bit_depth=16, **NOISELESS)
    still = np.mean([picture(scene, position) for position in np.linspace(594, 606, 49)], axis=0)
    moving = picture(scene, 600, travel_steps=12.0)
    assert np.abs(moving - still).max() < 0.01 * still.max()


def test_a_renderer_never_hands_out_the_same_array_twice():
    renderer = Renderer(scene_of())
    assert not np.shares_memory(renderer.render(0, **CAMERA), renderer.render(0, **CAMERA))


def test_the_corners_of_the_board_are_found_where_its_geometry_puts_them():
    scene = scene_of(size=(512, 384), object="checkerboard", tilt_x_deg=4.0, tilt_y_deg=-6.0, yaw_deg=3.0)
    grey = cv2.cvtColor(picture(scene, lamp=0.0).astype(np.uint8), cv2.COLOR_RGB2GRAY)
    found, corners = cv2.findChessboardCornersSB(grey, (15, 12))
    assert found
    steps = np.stack(np.meshgrid(np.arange(15) - 7.0, np.arange(12) - 5.5, [0.0]), axis=-1).reshape(-1, 3) * 0.3
    world = steps @ np.array(scene.form.rows) + np.array(scene.form.origin_mm)
    camera = scene.camera
    rotation, _ = cv2.Rodrigues(camera.rotation)
    exact, _ = cv2.projectPoints(world, rotation, camera.translation, camera.matrix, camera.distortion)
    nearest = np.linalg.norm(corners.reshape(-1, 1, 2) - exact.reshape(1, -1, 2), axis=-1).min(axis=1)
    assert np.sqrt((nearest**2).mean()) < 0.1


def test_a_tilted_board_rests_on_the_stage():
    scene = scene_of(object="checkerboard", tilt_y_deg=8.0)
    heights = scene.points_mm[24, :, 2][scene.on_object[24]]
    assert heights[1] > heights[-2]
    assert heights.min() > -0.01


def test_the_board_lying_flat_has_its_pattern_at_height_zero_and_the_foil_below():
    scene = scene_of(object="checkerboard", board_thickness_mm=0.8)
    np.testing.assert_allclose(scene.points_mm[24, 32, 2], 0.0, atol=1e-6)
    np.testing.assert_allclose(scene.points_mm[0, 0, 2], -0.8, atol=1e-9)


@pytest.mark.parametrize("name", ["stirrup", "dome", "wedge"])
def test_normals_are_those_of_the_surface_between_neighbouring_pixels(name):
    scene = scene_of(size=(256, 192), object=name)
    step = scene.points_mm[:, 1:] - scene.points_mm[:, :-1]
    smooth = (
        scene.on_object[:, 1:]
        & scene.on_object[:, :-1]
        & (scene.normals[:, 1:, 2] > 0.8)
        & (np.abs(step[..., 2]) < 0.02)
    )
    leaning = np.abs((step * (scene.normals[:, 1:] + scene.normals[:, :-1]) / 2).sum(axis=-1)[smooth])
    assert np.percentile(leaning, 95) < 0.002
    np.testing.assert_allclose(np.linalg.norm(scene.normals, axis=-1), 1.0, atol=1e-6)


def test_the_stirrup_has_a_hole_through_which_the_stage_is_seen():
    scene = scene_of(size=(128, 96))
    assert scene.points_mm[48, 64, 2] == pytest.approx(-0.5)
    assert scene.on_object[48, :64].any()
    assert scene.on_object[48, 64:].any()


def test_shadow_bits_are_interpolated_between_stage_positions():
    bits = np.uint64(0b110)
    assert [visible_share(bits, at, 0.0, 10.0) for at in (0.0, 5.0, 10.0, 20.0, 27.5)] == [0.0, 0.5, 1.0, 1.0, 0.25]


def test_the_truth_file_holds_the_promised_arrays(tmp_path):
    exact = truth(scene_of(), 0, 3, 527)
    write_truth(tmp_path / "truth.h5", exact)
    with h5py.File(tmp_path / "truth.h5") as file:
        stored = {
            name: (array.dtype.str, array.shape) for name, array in file.items() if isinstance(array, h5py.Dataset)
        }
        np.testing.assert_array_equal(file["crossing"], exact.crossing)
    assert stored == {
        "points": ("<f8", (48, 64, 3)),
        "crossing": ("<f8", (48, 64)),
        "normals": ("<f4", (48, 64, 3)),
        "visible": ("|u1", (48, 64)),
        "amplitude": ("<f4", (48, 64)),
        "edge_width": ("<f4", (48, 64)),
    }


def test_a_truth_file_that_cannot_be_written_leaves_nothing_behind(tmp_path):
    (tmp_path / "truth.h5").mkdir()
    with pytest.raises(OSError, match="truth"):
        write_truth(tmp_path / "truth.h5", truth(scene_of(size=(16, 12)), 0, 3, 3))
    assert [path.name for path in tmp_path.iterdir()] == ["truth.h5"]


def test_the_ideal_calibration_is_accepted_as_a_calibration_file():
    ideal = ideal_calibration(scene_of(), first_steps=0, steps_per_frame=3, count=527)
    parsed = parse_calibration(json.dumps(ideal))
    assert parsed.light_plane.parameter == "position_um"
    assert np.linalg.norm(parsed.light_plane.corner_velocity_mm) == pytest.approx(1e-3)


def test_frame_and_position_parameters_name_the_same_plane():
    scene = scene_of()
    sweep = {"first_steps": 300, "steps_per_frame": -6, "count": 20}
    by_um, by_frame = (
        ideal_calibration(scene, **sweep, parameter=parameter)["light_plane"] for parameter in ("position_um", "frame")
    )
    for index in (0, 7):
        um, frame = (300 - 6 * index) * 3.175, index + 1
        np.testing.assert_allclose(
            np.array(by_um["corner_origin_mm"]) + um * np.array(by_um["corner_velocity_mm"]),
            np.array(by_frame["corner_origin_mm"]) + frame * np.array(by_frame["corner_velocity_mm"]),
            atol=1e-12,
        )


@pytest.mark.parametrize(
    ("config", "size", "um", "message"),
    [
        ({"edge_width_um": -1.0}, (16, 12), 3.175, "edge_width_um"),
        ({"object": "teapot"}, (16, 12), 3.175, "teapot"),
        ({}, (0, 12), 3.175, "0 x 12"),
        ({}, (16, 12), 0.0, "um_per_microstep"),
        ({"board_square_mm": float("nan")}, (16, 12), 3.175, "board_square_mm"),
    ],
)
def test_a_scene_that_cannot_be_is_refused_by_name(config, size, um, message):
    with pytest.raises(ConfigError, match=message):
        build_scene(SimulationConfig(**config), width=size[0], height=size[1], um_per_microstep=um)
