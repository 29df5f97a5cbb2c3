"""Where the eye and the light stand; no server needed."""

from __future__ import annotations

import contextlib
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from acquire.contract.calibration import Calibration, parse_calibration
from acquire.contract.messaging.messages import Status
from acquire.contract.plan import SweepPlan
from process.viewer.rig_client.tile import Bounds
from process.viewer.scene.camera_views import ECHO_NS, Framing, Pose, overview
from process.viewer.scene.polylines import box_edges, field_of_view, light_at, sheet
from process.viewer.scene.rig_marks import travel_of
from process.viewer.scene.scene import CalibrationBook, nice_length_mm

BOX = Bounds((-5.0, -4.0, 0.0), (5.0, 4.0, 3.0))
PLAN = SweepPlan(first_steps=0, last_steps=300, steps_per_frame=3, um_per_microstep=3.175)


class Still:
    """A clock that a test moves."""

    def __init__(self) -> None:
        self.ns = 10 * ECHO_NS

    def now_ns(self) -> int:
        return self.ns


def page_without_browsers() -> Any:
    return SimpleNamespace(
        initial_camera=SimpleNamespace(),
        on_client_connect=lambda callback: None,
        on_client_disconnect=lambda callback: None,
        get_clients=dict,
    )


def calibration(light: dict[str, Any]) -> Calibration:
    camera = {
        "width": 1024,
        "height": 768,
        "K": [[10_000, 0, 511.5], [0, 10_000, 383.5], [0, 0, 1]],
        "R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
        "T": [0, 0, 100],
    }
    fields = {"format": "sweepscope-calibration", "version": 1, "camera": camera, "light_plane": light}
    return parse_calibration(json.dumps(fields))


TRANSLATING = {
    "kind": "translating",
    "normal": [2, 0, 0],
    "corner_origin_mm": [-5, 0, 0],
    "corner_velocity_mm": [0.01, 0, 0],
}


def test_the_whole_box_is_in_view_of_the_overview_and_fills_it() -> None:
    pose = overview(BOX)
    corners = np.array([[x, y, z] for x in (-5, 5) for y in (-4, 4) for z in (0, 3)])
    axis = (pose.target - pose.eye) / pose.distance_mm
    right = np.cross(axis, (0, 0, 1))
    right /= np.linalg.norm(right)
    up = np.cross(right, axis)
    seen = corners - pose.eye
    vertical = np.abs(seen @ up / (seen @ axis)) / math.tan(math.radians(20))
    horizontal = np.abs(seen @ right / (seen @ axis)) / math.tan(math.radians(20)) / 1.2
    assert 0.85 < max(vertical.max(), horizontal.max()) < 1.0
    assert pose.eye[2] > BOX.high[2], "one looks from above"


def test_new_browsers_start_at_the_overview_of_the_cloud() -> None:
    page = page_without_browsers()
    Framing(page, Still()).follow(BOX)
    assert page.initial_camera.look_at == pytest.approx(BOX.centre)
    assert page.initial_camera.near < BOX.radius_mm / 10


def test_a_camera_that_a_person_moved_is_not_followed_any_more_and_an_echo_is_no_person() -> None:
    clock = Still()
    framing = Framing(page_without_browsers(), clock)
    viewer = framing._viewers[7] = _viewer(framing, clock)
    elsewhere = Pose(viewer.set_to.eye * 1.5, viewer.set_to.target)
    framing._moved(7, elsewhere)
    assert viewer.follows, "what comes back at once is our own setting"
    clock.ns += 2 * ECHO_NS
    framing._moved(7, viewer.set_to)
    assert viewer.follows, "standing where it was put is not moving"
    framing._moved(7, elsewhere)
    assert not viewer.follows


def test_a_named_view_is_taken_by_the_browser_that_asks_and_kept_while_the_cloud_grows() -> None:
    page = page_without_browsers()
    asks, other = browser(1), browser(2)
    page.get_clients = lambda: {1: asks, 2: other}
    framing = Framing(page, Still())
    framing.fit(asks, "Top")
    framing.follow(Bounds((-50.0, -40.0, 0.0), (50.0, 40.0, 3.0)))
    eye = np.asarray(asks.camera.position) - asks.camera.look_at
    assert eye[2] / np.linalg.norm(eye) > 0.999
    assert not hasattr(other.camera, "position")
    with pytest.raises(KeyError):
        framing.fit(asks, "Behind")


def browser(client_id: int) -> Any:
    return SimpleNamespace(client_id=client_id, camera=SimpleNamespace(), atomic=contextlib.nullcontext)


@pytest.mark.parametrize(
    ("parameter", "velocity"), [("position_um", [0.001, 0.0, 0.0]), ("frame", [0.009525, 0.0, 0.0])]
)
def test_the_travel_of_the_stage_is_drawn_to_scale_beside_the_field(parameter: str, velocity: list[float]) -> None:
    known = calibration(TRANSLATING | {"parameter": parameter, "corner_velocity_mm": velocity})
    status = Status(state="sweeping", position_steps=150, position_um=150 * 3.175, travel_steps=(0, 300), plan=PLAN)
    found = travel_of(known, status, BOX)
    assert found is not None
    assert found.limits[1, 0] - found.limits[0, 0] == pytest.approx(300 * 3.175e-3)
    assert (found.now[0] - found.limits[0, 0]) == pytest.approx(150 * 3.175e-3)
    assert found.sweep == pytest.approx(found.limits)
    assert found.now[1] < BOX.low[1]


def test_without_a_plane_that_moves_the_travel_is_not_drawn() -> None:
    table = {"kind": "per-frame", "parameter": "frame", "first_frame": 1, "planes": [[1, 0, 0, 0], [1, 0, 0, 2]]}
    assert travel_of(calibration(table), Status(state="idle"), BOX) is None
    upward = calibration(
        TRANSLATING | {"parameter": "position_um", "normal": [0, 0, 1], "corner_velocity_mm": [0, 0, 1]}
    )
    assert travel_of(upward, Status(state="idle", position_steps=1, position_um=3.0), BOX) is None


def test_before_the_first_scan_the_rigs_own_calibration_is_drawn_and_a_broken_one_is_none(tmp_path: Path) -> None:
    known = calibration(TRANSLATING | {"parameter": "position_um"})
    good, bad = tmp_path / "calibration.json", tmp_path / "broken.json"
    good.write_bytes(msgspec.json.encode(known))
    bad.write_text("{")
    assert CalibrationBook(Still(), str(good)).of("") == known
    assert CalibrationBook(Still(), str(bad)).of("") is None
    assert CalibrationBook(Still(), str(good)).of(str(tmp_path / "scan-without-any")) is None


def test_the_edges_of_a_box_are_twelve() -> None:
    edges = box_edges(BOX)
    assert edges.shape == (12, 2, 3)
    assert sorted(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).tolist()) == [3.0] * 4 + [8.0] * 4 + [10.0] * 4


def _viewer(framing: Framing, clock: Still) -> Any:
    from process.viewer.scene.camera_views import _Viewer

    return _Viewer(overview(framing._bounds), clock.now_ns())


def test_the_field_of_view_on_the_floor_is_that_of_the_pinhole() -> None:
    field = field_of_view(calibration(TRANSLATING | {"parameter": "position_um"}).camera)
    assert field is not None
    assert field.low == pytest.approx((-5.12, -3.84, 0.0))
    assert field.high == pytest.approx((5.12, 3.84, 0.0))


@pytest.mark.parametrize(
    ("parameter", "position_steps", "expected_mm"), [("position_um", 0, -2.0), ("frame", 3 * 99, -4.0)]
)
def test_the_light_stands_where_the_calibration_says(parameter: str, position_steps: int, expected_mm: float) -> None:
    known = calibration(TRANSLATING | {"parameter": parameter})
    found = light_at(known, PLAN, position_steps, position_um=300.0)
    assert found is not None
    normal, offset = found
    assert normal == pytest.approx([1.0, 0.0, 0.0])
    assert offset == pytest.approx(expected_mm)


def test_planes_by_frame_are_interpolated_and_end_with_their_table() -> None:
    table = {"kind": "per-frame", "parameter": "frame", "first_frame": 1, "planes": [[1, 0, 0, 0], [1, 0, 0, 2]]}
    known = calibration(table)
    found = light_at(known, SweepPlan(0, 10, 2, 1.0), position_steps=1, position_um=0.0)
    assert found is not None
    assert found[1] == pytest.approx(1.0)
    assert light_at(known, SweepPlan(0, 10, 2, 1.0), position_steps=4, position_um=0.0) is None


def test_the_sheet_of_light_lies_in_its_plane_and_is_not_drawn_far_from_the_object() -> None:
    normal = np.array([0.8, 0.0, 0.6])
    corners = sheet(normal, 1.0, BOX)
    assert corners is not None
    assert corners @ normal == pytest.approx(np.ones(4))
    assert sheet(normal, 500.0, BOX) is None


@pytest.mark.parametrize(("length", "nice"), [(0.9, 1.0), (1.0, 1.0), (1.3, 2.0), (0.021, 0.05), (7.0, 10.0)])
def test_the_floor_has_cells_of_a_nice_length(length: float, nice: float) -> None:
    assert nice_length_mm(length) == pytest.approx(nice)
