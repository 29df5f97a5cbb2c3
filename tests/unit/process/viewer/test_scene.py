"""Where cameras and light are; no server needed."""

from __future__ import annotations

import asyncio
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
from process.viewer.rig_client.tile import BoundingBox
from process.viewer.scene.camera_views import DEFAULT_BOUNDS, ECHO_NS, CameraPose, CameraViews, overview
from process.viewer.scene.geometry import box_edges, field_of_view, light_at, sheet
from process.viewer.scene.rig_marks import travel_of
from process.viewer.scene.scene import CalibrationLookup

BOX = BoundingBox((-5.0, -4.0, 0.0), (5.0, 4.0, 3.0))
LARGE = BoundingBox((-50.0, -40.0, 0.0), (50.0, 40.0, 3.0))
PLAN = SweepPlan(first_steps=0, last_steps=300, steps_per_frame=3, um_per_microstep=3.175)


class Still:
    """A clock that a test moves."""

    def __init__(self) -> None:
        self.ns = 10 * ECHO_NS

    def now_ns(self) -> int:
        return self.ns


class Server:
    """As much of viser's server as the cameras need."""

    def __init__(self) -> None:
        self.initial_camera = SimpleNamespace()
        self.clients: dict[int, Any] = {}

    def on_client_connect(self, callback: Any) -> None:
        self._joined = callback

    def on_client_disconnect(self, callback: Any) -> None:
        self._left = callback

    def get_clients(self) -> dict[int, Any]:
        return self.clients

    def join(self, client_id: int) -> Any:
        """A browser comes; ``browser.move(pose)`` is what its person does."""
        callbacks: list[Any] = []
        camera = SimpleNamespace(aspect=1.6, on_update=callbacks.append)
        browser = SimpleNamespace(client_id=client_id, camera=camera, atomic=contextlib.nullcontext)

        def move(pose: CameraPose) -> None:
            camera.position, camera.look_at = pose.eye, pose.target
            asyncio.run(callbacks[0](camera))

        browser.move = move
        self.clients[client_id] = browser
        asyncio.run(self._joined(browser))
        return browser

    def leave(self, client_id: int) -> None:
        asyncio.run(self._left(self.clients.pop(client_id)))


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
    server = Server()
    CameraViews(server, Still()).follow(BOX)
    assert server.initial_camera.look_at == pytest.approx(BOX.centre)
    assert server.initial_camera.near < BOX.radius_mm / 10


def test_a_camera_that_a_person_moved_is_not_followed_any_more_and_an_echo_is_no_person() -> None:
    server, clock = Server(), Still()
    views = CameraViews(server, clock)
    echoing, standing, moved, left = (server.join(number) for number in range(4))
    seen = overview(DEFAULT_BOUNDS)
    elsewhere = CameraPose(seen.eye * 1.5, seen.target)
    echoing.move(elsewhere)  # what comes back at once is our own setting
    clock.ns += 2 * ECHO_NS
    standing.move(seen)  # standing where it was put is not moving
    moved.move(elsewhere)
    server.leave(3)
    views.follow(LARGE)
    for browser in (echoing, standing):
        assert browser.camera.look_at == pytest.approx(LARGE.centre)
    assert moved.camera.look_at == pytest.approx(elsewhere.target)
    assert not hasattr(left.camera, "look_at")


def test_a_named_view_is_taken_by_the_browser_that_asks_and_kept_while_the_cloud_grows() -> None:
    server = Server()
    views = CameraViews(server, Still())
    asks, other = server.join(1), server.join(2)
    views.fit(asks, "Top")
    assert not hasattr(other.camera, "position")
    views.follow(LARGE)
    eye = np.asarray(asks.camera.position) - asks.camera.look_at
    assert eye[2] / np.linalg.norm(eye) > 0.999
    with pytest.raises(KeyError):
        views.fit(asks, "Behind")


def test_a_person_who_asks_for_a_view_is_followed_again() -> None:
    server, clock = Server(), Still()
    views = CameraViews(server, clock)
    browser = server.join(1)
    clock.ns += 2 * ECHO_NS
    browser.move(CameraPose(np.array([9.0, 9.0, 9.0]), np.zeros(3)))
    views.fit(browser)
    views.follow(LARGE)
    assert browser.camera.look_at == pytest.approx(LARGE.centre)


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
    assert CalibrationLookup(Still(), str(good)).of("") == known
    assert CalibrationLookup(Still(), str(bad)).of("") is None
    assert CalibrationLookup(Still(), str(good)).of(str(tmp_path / "scan-without-any")) is None


def test_the_edges_of_a_box_are_twelve() -> None:
    edges = box_edges(BOX)
    assert edges.shape == (12, 2, 3)
    assert sorted(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).tolist()) == [3.0] * 4 + [8.0] * 4 + [10.0] * 4


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
