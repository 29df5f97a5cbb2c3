"""Light planes of a drawn room are where the shadow truly is, and what goes wrong is said."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from acquire.contract.errors import CalibrationError
from acquire.importing.folder import import_folder
from process.calibration.reference_planes.frame_planes import FramePlane, Scene, bridged, jumping
from process.calibration.reference_planes.light_point import find_light_point
from process.calibration.reference_planes.recipe import calibrate_sweep
from process.calibration.reference_planes.result import ReferenceResult
from tests.reference.shadow_sequence import LAMP_MM, Room

PLACES = np.array([[-150.0, -50, 1750], [150, -50, 1750], [-150, 150, 1800], [150, 150, 1800]])


def calibrated(room: Room, folder: Path, edge: str = "falling", **options: object) -> ReferenceResult:
    room.write(folder / "room")
    scan = folder / "scan.h5"
    import_folder(folder / "room" / "frames", scan)
    files = folder / "room" / "camera.json", folder / "room" / "planes.json"
    return calibrate_sweep(scan, *files, method="linear", edge=edge, contrast=50, **options)[0]


def errors_mm(result: ReferenceResult, room: Room, edge: str = "falling") -> np.ndarray:
    """Largest distance from the true plane in the scene, by plane."""
    found = []
    for plane in result.planes:
        true = room.light_plane(plane.t - 1, edge)
        gap = PLACES @ plane.normal - plane.offset
        gap -= np.sign(true[:3] @ plane.normal) * (PLACES @ true[:3] - true[3])
        found.append(np.abs(gap).max())
    return np.array(found)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> ReferenceResult:
    return calibrated(Room(), tmp_path_factory.mktemp("plain"))


def two_lines(result: ReferenceResult) -> list[int]:
    return [plane.t for plane in result.planes if plane.source == "two lines"]


def test_planes_are_those_of_the_shadow_and_every_frame_has_one_or_a_reason(plain):
    room = Room()
    assert len(two_lines(plain)) >= 17
    assert np.median(errors_mm(plain, room)) < 0.5 and errors_mm(plain, room).max() < 6.0
    assert {plane.t for plane in plain.planes} | set(plain.reasons) == set(range(1, room.frames + 1))
    assert not {plane.t for plane in plain.planes} & set(plain.reasons)
    assert plain.skew_mm.max() < 0.5


def test_the_lamp_is_found_where_it_is(plain):
    assert plain.light is not None
    assert np.linalg.norm(plain.light.place - LAMP_MM) < 80  # along the stick it is hardly known


def test_the_end_of_the_shadow_is_a_rising_edge(tmp_path):
    room = Room()
    result = calibrated(room, tmp_path, "rising")
    assert len(two_lines(result)) >= 15
    assert np.median(errors_mm(result, room, "rising")) < 1.5


def pausing(index: int) -> float:
    return -20.0 + (index if index < 15 else 15 if index < 20 else index - 5)


def reversing(index: int) -> float:
    return -20.0 + (index if index < 18 else 36 - index if index < 22 else index - 8)


def jerky(index: int) -> float:
    return -20.0 + index + 0.7 * np.sin(1.7 * index)


WRONG_AT_TURN = "one frame of a sweep that turns back is off by the shadow's width, and is kept"


@pytest.mark.parametrize(
    "angle", [pausing, pytest.param(reversing, marks=pytest.mark.xfail(strict=True, reason=WRONG_AT_TURN)), jerky]
)
def test_a_hand_may_pause_turn_back_and_jerk(angle, tmp_path):
    room = Room(angle=angle, frames=46)
    result = calibrated(room, tmp_path)
    assert len(two_lines(result)) >= 15
    assert np.median(errors_mm(result, room)) < 0.6 and errors_mm(result, room).max() < 6.0


def test_planes_stay_right_where_the_camera_changes_its_exposure(tmp_path):
    room = Room(gain=lambda index: 1 + 0.12 * np.sin(index / 4))
    result = calibrated(room, tmp_path)
    assert len(two_lines(result)) >= 15
    assert np.median(errors_mm(result, room)) < 1.0


def test_a_dark_noisy_sequence_still_gives_planes(tmp_path):
    room = Room(lit=95.0, dark=38.0, noise=3.0)
    result = calibrated(room, tmp_path)
    assert len(two_lines(result)) >= 15
    assert np.median(errors_mm(result, room)) < 1.5


def hand(index: int, picture: np.ndarray) -> None:
    """A dark hand moves about within the wall's region."""
    x = 90 + 2 * index
    picture[4:20, x : x + 12] = 25


def test_a_hand_within_a_region_does_not_move_the_planes(tmp_path):
    room = Room(spoil=hand)
    result = calibrated(room, tmp_path)
    assert len(two_lines(result)) >= 15
    assert np.median(errors_mm(result, room)) < 1.0 and errors_mm(result, room).max() < 6.0


def hidden_floor(index: int, picture: np.ndarray) -> None:
    """The floor's edge cannot be seen for a few frames."""
    if 18 <= index < 26:
        picture[130:] = 200.0


def test_frames_with_one_line_get_their_plane_with_the_lamp_and_it_is_said(tmp_path):
    room = Room(spoil=hidden_floor)
    result = calibrated(room, tmp_path)
    made = {plane.t: plane.source for plane in result.planes}
    assert all("line on the wall and the common light point" in made[t] for t in range(20, 25))
    assert np.median(errors_mm(result, room)) < 0.6 and errors_mm(result, room).max() < 6.0
    assert any("common light point" in line for line in result.lines())


def blackout(index: int, picture: np.ndarray) -> None:
    if 18 <= index < 21:
        picture[:] = 200.0


def test_short_gaps_are_bridged_where_the_motion_is_smooth_and_it_is_said(tmp_path):
    room = Room(spoil=blackout)
    result = calibrated(room, tmp_path)
    made = {plane.t: plane.source for plane in result.planes}
    assert made[20].startswith("interpolated between frames 1")
    assert np.median(errors_mm(result, room)) < 0.6 and errors_mm(result, room).max() < 6.0


def long_blackout(index: int, picture: np.ndarray) -> None:
    if 16 <= index < 25:
        picture[:] = 200.0


def test_long_gaps_stay_gaps_which_are_null_and_counted(tmp_path):
    result = calibrated(Room(spoil=long_blackout), tmp_path)
    document = result.document()
    assert None in document["planes"]
    assert result.reasons[20] == "no edge on the wall and the floor"
    assert document["quality"]["frames"]["20"].startswith("no plane: no edge")
    assert any("no plane: frames" in line for line in result.lines())
    assert json.dumps(document, allow_nan=False)


def test_lines_of_planes_that_do_not_fit_each_other_are_refused_in_one_sentence(tmp_path):
    room = Room()
    planes = room.planes()
    planes["reference_planes"]["floor"]["marker_rectangle_mm"] = [700.0, 350.0]  # the floor is too far away then
    room.planes = lambda: planes  # type: ignore[method-assign]
    with pytest.raises(CalibrationError, match="of .* frames .* lines that miss each other by more than") as error:
        calibrated(room, tmp_path)
    assert "\n" not in str(error.value)


def test_no_contrast_is_said_with_the_option_that_helps(tmp_path):
    with pytest.raises(CalibrationError, match="--contrast"):
        calibrated(Room(lit=200.0, dark=170.0), tmp_path)


def plane(t: int, offset: float) -> FramePlane:
    return FramePlane(t, np.array([1.0, 0, 0]), offset, 0.1, "two lines")


SCENE = Scene(np.zeros(3), 500.0)


def test_a_plane_that_jumps_out_and_back_is_named():
    planes = {t: plane(t, 10.0 * t) for t in range(1, 9)} | {5: plane(5, 150.0)}
    assert list(jumping(planes, PLACES, SCENE)) == [5]


def test_a_jump_of_the_hand_is_no_wrong_plane():
    planes = {t: plane(t, 10.0 * t + (200 if t > 4 else 0)) for t in range(1, 9)}
    assert not jumping(planes, PLACES, SCENE)


def test_a_gap_in_a_jerk_is_not_bridged():
    smooth = {t: plane(t, 10.0 * t) for t in (1, 2, 5, 6)}
    jerk = {t: plane(t, 10.0 * t + (60 if t > 4 else 0)) for t in (1, 2, 5, 6)}
    assert sorted(bridged(smooth, PLACES, SCENE)) == [3, 4]
    assert not bridged(jerk, PLACES, SCENE)


def test_planes_without_a_common_point_have_none():
    generator = np.random.default_rng(1)
    normals = generator.normal(size=(30, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    assert find_light_point(normals, generator.uniform(-500, 500, 30), np.zeros(3), 500.0) is None


@pytest.mark.parametrize("distance_mm", [1e3, 1e5, 1e9])
def test_a_common_point_is_found_however_far_and_despite_wrong_planes(distance_mm):
    generator = np.random.default_rng(2)
    lamp = distance_mm * np.array([0.3, -0.6, 0.74])
    normals = np.column_stack([np.ones(40), generator.uniform(-0.2, 0.2, 40), generator.uniform(0.2, 0.6, 40)])
    places = generator.uniform(-200, 200, (40, 3))
    normals -= ((normals * (lamp - places)).sum(1) / ((lamp - places) ** 2).sum(1))[:, None] * (lamp - places)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    offsets = (normals * places).sum(axis=1)
    offsets[:8] += 150
    light = find_light_point(normals, offsets, np.zeros(3), 500.0)
    assert light is not None
    miss = light.miss_deg(normals, offsets)
    assert miss[8:].max() < 0.05
