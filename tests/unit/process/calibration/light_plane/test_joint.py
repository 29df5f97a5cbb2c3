"""Light plane, boards, stage and camera solved for together: what the light tells of boards, what it contradicts."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from acquire.contract.calibration import CameraModel, parse_calibration
from process.calibration.calibration_file import new_document
from process.calibration.light_plane.from_sweeps import PlaneResult, fit_plane
from process.calibration.light_plane.recipe import SweepRecipe, with_original_camera, with_plane
from process.calibration.light_plane.surfaces import Surface
from tests.accuracy.uncertainty import COARSE, SMALL, measured, point_errors_um


@pytest.fixture(scope="module")
def small():
    """Sweeps over a board on a twentieth of a telecentric picture."""
    return measured(SMALL, 3)


def fitted(surfaces: list[Surface], camera, known) -> PlaneResult:
    return fit_plane(surfaces, camera, edge="rising", method="auto", known_camera=known)


@pytest.fixture(scope="module")
def result(small) -> PlaneResult:
    return fitted(*small)


def test_a_board_on_a_twentieth_of_a_telecentric_picture_gives_points_within_microns_and_says_so(result):
    assert max(result.predicted_um) < 3.0
    assert point_errors_um(SMALL, result).max() < 3 * max(result.predicted_um)
    assert result.ok
    assert result.document()["quality"]["predicted_um"]["at_z0"] == result.predicted_um[0]


def test_boards_that_cover_less_than_half_of_the_field_have_the_predicted_error_said_beside_them(small):
    surfaces, camera, known = small
    upper = [replace(s, pixels=s.pixels[s.pixels // SMALL.size[0] < SMALL.size[1] // 2]) for s in surfaces]
    found = fitted(upper, camera, known)
    assert any("the boards cover" in note and "predicted error of a point" in note for note in found.notes)


def test_boards_that_were_all_taken_for_their_mirrored_poses_are_turned_over():
    surfaces, camera, known = measured(replace(SMALL, corner_noise_px=0.15), 3)
    right = fitted(surfaces, camera, known)
    again = fitted([mirrored(surface, camera) for surface in surfaces], camera, known)
    assert np.linalg.norm(again.a - right.a) < 0.1 * np.sqrt(np.trace(right.spread.total[:3, :3]))


def mirrored(surface: Surface, camera: CameraModel) -> Surface:
    """The same with its two poses exchanged."""
    own, to_world = surface.pose, np.array(camera.R).T
    assert own is not None
    assert own.other is not None
    pose = replace(own.other, rms_px=own.rms_px, other=replace(own, rms_px=own.other.rms_px, other=None))
    point = to_world @ (pose.translation - np.array(camera.T))
    return replace(surface, pose=pose, point=point, normal=to_world @ pose.normal)


def test_a_board_that_is_tilted_tells_nothing_of_where_the_stage_is(small):
    surfaces, camera, known = small
    without = fitted(surfaces[1:], camera, known)
    assert not any("lies flat" in note for note in without.notes)
    assert max(without.predicted_um) > 10.0
    assert any("more than 10 um are predicted: add sweeps over the board lying flat" in n for n in without.notes)


def test_a_board_that_was_lifted_between_its_picture_and_its_sweep_fails_and_is_named():
    surfaces, camera, known = measured(COARSE, 1)
    moved = surfaces[1].sweep
    lifted = replace(surfaces[1], sweep=replace(moved, name="lifted", crossing=moved.crossing + 0.02 * COARSE.a[2]))
    found = fitted([surfaces[0], lifted, surfaces[2]], camera, known)
    causes = {surface.name: surface.cause for surface in found.surfaces if not surface.ok}
    assert "um from where its corners do" in causes["lifted"]
    assert any("contradict each other" in note for note in found.notes)


def test_a_plane_is_made_again_with_the_camera_that_its_sweeps_had_no_say_in(small, result):
    _, camera, known = small
    fields = msgspec.to_builtins(camera) | {"quality": {"covariance": known.tolist(), "rms_px": 0.02}}
    document = new_document(fields)
    made = with_plane(document, result, SweepRecipe((), 13, 13, 0.1), days=30.0)
    assert parse_calibration(msgspec.json.encode(made).decode()).camera == result.camera
    assert made["camera"]["R"] != document["camera"]["R"]
    assert made["camera"]["quality"]["rms_px"] == 0.02
    assert with_original_camera(made)["camera"] == document["camera"]
    assert with_plane(made, result, SweepRecipe((), 13, 13, 0.1), days=30.0)["camera"] == made["camera"]


def test_a_camera_that_is_taken_as_exact_stays_as_it_is(small):
    surfaces, camera, _ = small
    found = fitted(surfaces, camera, None)
    assert np.allclose(found.camera.R, camera.R, atol=1e-12)
    assert found.camera.K == camera.K
    assert any("does not say how uncertain it is" in note for note in found.notes)
