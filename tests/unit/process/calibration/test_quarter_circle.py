"""The light plane from the slide's quarter circle: found on the simulated rig, given by hand, and impossible ones."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from acquire.contract.calibration import load_calibration
from acquire.contract.config.simulation import SimulationConfig
from acquire.contract.errors import CalibrationError
from acquire.simulation import build_scene, ideal_calibration
from process.calibration.calibration_file import new_document, write_document
from process.calibration.quarter_circle.optics import Slide
from tests.fakes.scans.simulated_scans import plan_of, simulate_sweep
from tui.cli import cli

SIZE = (320, 240)
PLAN = plan_of(steps=10)
WHITE = SimulationConfig(object="flat", colour=False, read_noise_counts=1.0, full_well_electrons=0.0)


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """A sweep over a white flat, the exact calibration, and the scene it is from."""
    folder = tmp_path_factory.mktemp("quarter")
    simulate_sweep(folder / "white", WHITE, size=SIZE, plan=PLAN)
    scene = build_scene(WHITE, width=SIZE[0], height=SIZE[1], um_per_microstep=3.175)
    exact = ideal_calibration(scene, first_steps=0, steps_per_frame=10, count=PLAN.count)
    write_document(folder / "exact.json", exact)
    write_document(folder / "camera.json", new_document(exact["camera"]))
    return folder, exact["light_plane"], scene


def run(folder, *arguments: str):
    everything = ["calibrate", "quarter-circle", str(folder / "white"), "--camera", str(folder / "exact.json")]
    result = CliRunner().invoke(cli, [*everything, *arguments], standalone_mode=False)
    if result.exception is not None:
        raise result.exception
    return result.output


def angle_deg(plane, truth) -> float:
    return float(np.degrees(np.arccos(min(np.dot(plane.normal, truth["normal"]), 1.0))))


def pixels_of(scene, places) -> np.ndarray:
    camera = scene.camera
    seen = (np.array(places) @ camera.rotation.T + camera.translation) @ camera.matrix.T
    return seen[:, :2] / seen[:, 2:]


def test_the_pattern_is_found_in_the_frames_and_gives_the_plane_and_its_true_velocity(rig, tmp_path):
    folder, truth, _ = rig
    output = run(folder, "--out", str(tmp_path / "c.json"))
    plane = load_calibration(tmp_path / "c.json")[0].light_plane
    assert angle_deg(plane, truth) < 0.25
    assert plane.corner_velocity_mm == pytest.approx(truth["corner_velocity_mm"], abs=5e-7)
    assert plane.corner_origin_mm == pytest.approx(truth["corner_origin_mm"], abs=1e-3)
    assert plane.velocity_direction == "corner-track"
    assert "the quarter circle against the other light plane: normals differ by 0." in output
    assert "data:image/png" in (tmp_path / "c-quarter-circle.html").read_text()


def clicks(scene) -> list[str]:
    projector = scene.projector
    corner = np.array(projector.corner_mm)
    normal, edge = np.array(projector.normal), np.array(projector.edge)
    side = np.array([edge[1], -edge[0], 0.0])
    assert normal @ side < 0
    rows = []
    for frame in (20, 140):
        at = corner + np.array(projector.step_mm) * PLAN.position_steps(frame)
        rows.append(("corner", frame, at))
        rows.append(("lead_end", frame, at + 1.8618 * edge))
        rows.append(("side_end", frame, at + 3.0524 * side))
    pixels = pixels_of(scene, [place for _, _, place in rows])
    return [f"{name},{frame},{x:.3f},{y:.3f}" for (name, frame, _), (x, y) in zip(rows, pixels, strict=True)]


def test_points_that_were_clicked_give_the_plane_where_the_pattern_is_not_found(rig, tmp_path):
    folder, truth, scene = rig
    (tmp_path / "points.csv").write_text("point,frame,x,y\n" + "\n".join(clicks(scene)))
    run(folder, "--points", str(tmp_path / "points.csv"), "--out", str(tmp_path / "c.json"))
    assert angle_deg(load_calibration(tmp_path / "c.json")[0].light_plane, truth) < 0.5


def test_clicked_points_may_be_json_too_and_must_hold_both_ends(rig, tmp_path):
    rows = [dict(zip(("point", "frame", "x", "y"), line.split(","), strict=True)) for line in clicks(rig[2])]
    rows = [{**row, "frame": int(row["frame"]), "x": float(row["x"]), "y": float(row["y"])} for row in rows]
    (tmp_path / "points.json").write_text(json.dumps([row for row in rows if row["point"] != "side_end"]))
    with pytest.raises(CalibrationError, match="no side_end was given"):
        run(rig[0], "--points", str(tmp_path / "points.json"), "--out", str(tmp_path / "c.json"))


def test_an_edge_shorter_than_hp_is_impossible_and_said_with_the_numbers(rig, tmp_path):
    (tmp_path / "p.csv").write_text("\n".join(clicks(rig[2])))
    with pytest.raises(CalibrationError, match=r"impossible geometry: .* hp is 6\.\d+ mm \(hp / d = 3\.\d+ > 1\)"):
        run(rig[0], "--hs-mm", "13", "--points", str(tmp_path / "p.csv"), "--out", str(tmp_path / "c.json"))
    assert [path.name for path in tmp_path.iterdir()] == ["p.csv"]


def test_a_sweep_without_the_pattern_is_refused_in_words(rig, tmp_path):
    board = SimulationConfig(object="checkerboard", colour=False, board_ambient=0.9)
    simulate_sweep(tmp_path / "dark", board, size=SIZE, plan=plan_of(0, 300, 20), lamp=0.0)
    arguments = ["calibrate", "quarter-circle", str(tmp_path / "dark"), "--camera", str(rig[0] / "camera.json")]
    result = CliRunner().invoke(cli, [*arguments, "--out", str(tmp_path / "c.json")], standalone_mode=False)
    assert isinstance(result.exception, CalibrationError)
    assert "pixels are ever lit: it takes a sweep over a white flat" in str(result.exception)


def test_both_angles_of_an_edge_give_its_length_by_equation_5():
    slide = Slide()
    for theta in slide.turns(3.0, "edge"):
        length = np.cos(slide.half_angle) / np.cos(slide.half_angle + theta) * slide.hp_mm
        assert length == pytest.approx(3.0)
