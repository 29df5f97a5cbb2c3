"""The light plane from sweeps over the board and from reference planes, against exact geometry and public data."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from acquire.contract.calibration import CameraModel, load_calibration
from acquire.contract.config.simulation import SimulationConfig
from acquire.contract.errors import CalibrationError
from acquire.contract.messaging.messages import FrameFormat
from acquire.importing.folder import import_folder
from acquire.simulation import build_scene, ideal_calibration
from process.calibration.calibration_file import new_document, read_document, write_document
from process.calibration.light_plane.from_sweeps import fit_plane
from process.calibration.light_plane.recipe import rezeroed
from process.calibration.light_plane.robust import solve
from process.calibration.light_plane.surfaces import Surface
from process.calibration.light_plane.sweeps import FoldedSweep, fold_sweep
from process.calibration.reference_planes.recipe import calibrate_sweep
from process.calibration.reference_planes.result import ReferenceResult
from process.cloud.triangulation import rays
from tests.fakes.processes.sweep_source import edge_frames
from tests.fakes.scans.simulated_scans import plan_of, simulate_sweep
from tui.cli import cli

CAMERA = CameraModel(
    width=96,
    height=72,
    K=((1100.0, 0.0, 50.0), (0.0, 1100.0, 34.0), (0.0, 0.0, 1.0)),
    R=((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    T=(0.0, 0.0, 77.0),
)
NORMAL = np.array([0.546, -0.0055, 0.838]) / np.linalg.norm([0.546, -0.0055, 0.838])
PER_UM = 0.546e-3


def surface(name: str, tilt: tuple[float, float], wild: float = 0.25, shift_mm: float = 0.0) -> Surface:
    """A plane and where the light crosses it, with noise, and a share of pixels that another edge crossed first."""
    normal = np.array([tilt[0], tilt[1], 1.0])
    normal /= np.linalg.norm(normal)
    view, point = rays(CAMERA), np.array([0.0, 0.0, 0.1])
    distance = (normal @ (point - view.centre_mm)) / (view.directions @ normal)
    x = view.centre_mm + distance[:, None] * view.directions
    generator = np.random.default_rng(len(name))
    um = (x @ NORMAL + shift_mm) / PER_UM + 3000 + generator.normal(0, 1.0, len(x))
    lost = generator.random(len(x)) < wild
    um[lost] -= generator.uniform(100, 2000, int(lost.sum()))
    frames = np.arange(1000) * 10.0
    sweep = FoldedSweep(
        name,
        (um / 10.0).reshape(72, 96),
        np.full((72, 96), 0.1),
        np.zeros((72, 96), np.uint8),
        frames,
        "position_um",
        None,
        FrameFormat(96, 72, 8),
    )
    return Surface(sweep, point, normal, np.arange(len(x)))


def test_the_plane_is_found_although_a_quarter_of_the_pixels_is_wrong_by_far():
    result = fit_plane([surface("flat", (0, 0)), surface("tilt", (0.2, 0.1))], CAMERA, edge="rising", method="linear")
    assert np.degrees(np.arccos(min(result.normal @ NORMAL, 1.0))) < 0.01
    assert result.speed_mm == pytest.approx(PER_UM, rel=1e-4)
    assert result.ok
    assert all(0.2 < part.outlier_share < 0.3 for part in result.surfaces)


def test_sweeps_in_one_plane_cannot_show_the_tilt_of_the_light():
    with pytest.raises(CalibrationError, match="lie in one plane"):
        fit_plane([surface("a", (0, 0)), surface("bb", (0, 0))], CAMERA, edge="rising", method="linear")


def test_a_surface_that_moved_by_5_um_fails_and_is_named():
    surfaces = [surface("flat", (0, 0)), surface("tilt", (0.2, 0.1)), surface("moved", (0.1, 0.2), shift_mm=0.005)]
    result = fit_plane(surfaces, CAMERA, edge="rising", method="linear")
    assert not result.ok
    assert "off the others" in "".join(part.cause for part in result.surfaces)


def test_the_height_of_a_flat_is_estimated_along_with_the_plane():
    flat = replace(surface("white", (0, 0)), point=np.zeros(3), free_height=True)
    result = fit_plane(
        [surface("one", (0.2, 0.1)), surface("other", (-0.2, 0.1)), flat], CAMERA, edge="rising", method="linear"
    )
    assert result.surfaces[2].height_mm == pytest.approx(0.1, abs=2e-4)


def test_flats_alone_are_refused():
    flat = replace(surface("white", (0, 0)), free_height=True)
    with pytest.raises(CalibrationError, match="flats alone"):
        fit_plane([flat], CAMERA, edge="rising", method="linear")


def test_a_plane_along_the_view_rays_is_refused():
    def along(name, tilt):
        good = surface(name, tilt, wild=0.0)
        view = rays(CAMERA)
        distance = (good.normal @ (good.point - view.centre_mm)) / (view.directions @ good.normal)
        x = view.centre_mm + distance[:, None] * view.directions
        return replace(good, sweep=replace(good.sweep, crossing=(x[:, 0] * 50 + 300).reshape(72, 96)))

    with pytest.raises(CalibrationError, match="parallel to the view rays"):
        fit_plane([along("flat", (0, 0)), along("tilt", (0.2, 0.1))], CAMERA, edge="rising", method="linear")


def test_robust_least_squares_ignores_a_third_of_wild_values():
    generator = np.random.default_rng(3)
    design = np.column_stack([generator.normal(size=900), np.ones(900)])
    values = design @ [2.0, -1.0] + generator.normal(0, 0.01, 900)
    values[:300] += 5
    assert solve(design, values).x == pytest.approx([2.0, -1.0], abs=0.003)


def test_a_calibration_that_is_there_is_not_replaced_without_force(tmp_path):
    scene = build_scene(SimulationConfig(colour=False), width=64, height=48, um_per_microstep=3.175)
    document = ideal_calibration(scene, first_steps=0, steps_per_frame=3, count=527)
    write_document(tmp_path / "c.json", document | {"mine": 1})
    assert read_document(tmp_path / "c.json")["mine"] == 1
    with pytest.raises(CalibrationError, match="left alone"):
        write_document(tmp_path / "c.json", document)


BOARD = {"object": "checkerboard", "colour": False, "board_columns": 21, "board_rows": 15, "relief": 0.0}
SMALL = (384, 288)


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory):
    """A board flat and tilted, swept coarsely by the simulated rig; and its exact camera."""
    folder = tmp_path_factory.mktemp("sweeps")
    plan = plan_of(steps=8)
    flat = SimulationConfig(**BOARD)
    tilted = SimulationConfig(**BOARD, tilt_x_deg=10.0)
    simulate_sweep(folder / "flat", flat, size=SMALL, plan=plan)
    simulate_sweep(folder / "tilted", tilted, size=SMALL, plan=plan)
    scene = build_scene(flat, width=SMALL[0], height=SMALL[1], um_per_microstep=3.175)
    ideal = ideal_calibration(scene, first_steps=0, steps_per_frame=8, count=plan.count)
    write_document(folder / "camera.json", new_document(ideal["camera"]))
    return folder, ideal["light_plane"]


def test_the_command_finds_the_light_plane_of_the_simulated_rig(sweeps):
    folder, truth = sweeps
    out = folder / "calibration.json"
    arguments = ["calibrate", "plane", str(folder / "flat"), str(folder / "tilted"), "--camera"]
    arguments += [str(folder / "camera.json"), "--squares", "21x15", "--square-mm", "0.3", "--out", str(out)]
    run = CliRunner().invoke(cli, [*arguments, "--force"], standalone_mode=False)
    assert run.exception is None, run.exception
    plane = load_calibration(out)[0].light_plane
    assert np.degrees(np.arccos(min(np.dot(plane.normal, truth["normal"]), 1.0))) < 0.5
    own = -np.dot(plane.normal, plane.corner_origin_mm) / np.dot(plane.normal, plane.corner_velocity_mm)
    exact = -np.dot(truth["normal"], truth["corner_origin_mm"]) / np.dot(truth["normal"], truth["corner_velocity_mm"])
    assert abs(own - exact) < 25, "um of travel when the light passes the world's origin"
    assert "position_um" in out.read_text()
    page = (folder / "calibration-plane.html").read_text()
    assert "data:image/png;base64," in page
    assert "http" not in page


def test_rezero_finds_by_how_much_the_stage_was_homed_elsewhere(sweeps):
    folder, truth = sweeps
    document = read_document(folder / "camera.json") | {"light_plane": truth}
    write_document(folder / "ideal.json", document, force=True)
    write_document(folder / "moved.json", rezeroed(document, -40.0), force=True)
    shifts = []
    for name in ("ideal", "moved"):
        arguments = ["calibrate", "rezero", str(folder / "flat"), "--calibration", str(folder / f"{name}.json")]
        arguments += [
            "--squares",
            "21x15",
            "--square-mm",
            "0.3",
            "--out",
            str(folder / "new.json"),
            "--force",
            "--json",
        ]
        run = CliRunner().invoke(cli, arguments, standalone_mode=False)
        assert run.exception is None, run.exception
        shifts.append(json.loads(run.output.splitlines()[-1])["shift_um"])
    per_um = np.dot(truth["normal"], truth["corner_velocity_mm"]) * 1000
    assert shifts[1] - shifts[0] == pytest.approx(40.0 * per_um, abs=0.05)


def test_check_passes_the_exact_plane_and_fails_one_that_is_tilted(sweeps):
    folder, truth = sweeps
    tilted = dict(truth, normal=[0.55, 0.03, 0.83])
    verdicts = []
    for name, plane in (("exact", truth), ("tilted", tilted)):
        document = read_document(folder / "camera.json") | {"light_plane": plane}
        write_document(folder / f"{name}.json", document, force=True)
        arguments = ["calibrate", "check", str(folder / "flat"), "--calibration", str(folder / f"{name}.json")]
        arguments += ["--squares", "21x15", "--square-mm", "0.3", "--limit-um", "25"]
        verdicts.append(CliRunner().invoke(cli, arguments, standalone_mode=False).return_value)
    assert verdicts == [0, 1]


def test_a_sweep_that_never_reaches_the_board_is_named(tmp_path):
    dark = simulate_sweep(
        tmp_path / "dark", SimulationConfig(**BOARD), size=(96, 72), plan=plan_of(0, 40, 8), exposure_ms=1.0
    )
    with pytest.raises(CalibrationError, match="dark: only .* pixels change their brightness enough"):
        fold_sweep(dark)


def test_a_sweep_of_the_other_edge_is_told_so(tmp_path):
    (tmp_path / "frames").mkdir()
    for k, frame in enumerate(edge_frames(40, 64, 48)):
        cv2.imwrite(str(tmp_path / "frames" / f"{k}.png"), 255 - frame)
    import_folder(tmp_path / "frames", tmp_path / "scan.h5")
    with pytest.raises(CalibrationError, match=r"the light goes the other way.*--edge falling"):
        fold_sweep(tmp_path / "scan.h5", edge="rising", contrast=50)


def apart(result: ReferenceResult, given: dict) -> tuple[np.ndarray, np.ndarray]:
    """Degrees, and mm at the middle of the scene, between the planes of the same frames."""
    first, theirs = given["light_plane"]["first_frame"], np.array(given["light_plane"]["planes"])
    angles, gaps = [], []
    for plane in result.planes:
        if not first <= plane.t < first + len(theirs):
            continue
        other = theirs[plane.t - first] / np.linalg.norm(theirs[plane.t - first][:3])
        angles.append(np.degrees(np.arccos(min(abs(other[:3] @ plane.normal), 1.0))))
        middle = np.array([0.0, -20.0, 1650.0])
        middle -= (other[:3] @ middle - other[3]) * other[:3]
        gaps.append(abs(plane.normal @ middle - plane.offset))
    return np.array(angles), np.array(gaps)


def test_planes_of_the_public_scan_are_those_of_an_independent_implementation(real_scan, tmp_path):
    given = json.loads((real_scan / "calibration.json").read_text())
    scan, own = tmp_path / "frog.h5", tmp_path / "camera.json"
    for arguments in (
        ["import", str(real_scan / "frames"), str(scan)],
        ["calibrate", "camera", str(real_scan / "checkerboard"), "--squares", "9x7", "--square-mm", "30",
         "--out", str(own)],
    ):  # fmt: skip
        assert CliRunner().invoke(cli, arguments, standalone_mode=False).exception is None
    markers = real_scan / "calibration.json"
    for camera_file in (markers, own):
        result = calibrate_sweep(scan, camera_file, markers, method="linear", edge="falling", contrast=50)[0]
        angles, gaps = apart(result, given)
        assert len(angles) > 95
        assert np.median(angles) < 0.1 and max(angles) < 0.3, camera_file
        assert np.median(gaps) < 1.0, camera_file
