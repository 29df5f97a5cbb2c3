"""What a calibration is worth: spheres, flats, the board's squares and a second sweep, against limits."""

from __future__ import annotations

import json

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from acquire.contract.config.model import CheckConfig
from acquire.contract.errors import CalibrationError
from process.calibration.board.detection import Board
from process.calibration.calibration_file import new_document, write_document
from process.calibration.check.planarity import repeatability
from process.calibration.check.spheres import find_spheres, fit_sphere
from process.calibration.check.verdict import sphere_figures
from tests.fakes.scans.drawn_boards import PINHOLE, Light, bulge, caps, chessboard, sweep, turned
from tui.cli import cli

BOARD = Board(13, 10, 0.3)
AT, FLAT = np.array([0.0, 0.0, 20.0]), turned(0, 0, 0)
SPHERES = [(-1.1, 0.1, 1.0), (1.2, -0.1, 0.8)]
A = np.array([10.0, 0.0, 16.0])
"""Of the drawn light: t = A . X + 45 in frames, 10 um of travel each."""


def white(at: np.ndarray) -> np.ndarray:
    return np.full(at.shape[:-1], 0.8)


def bright_on_top(at: np.ndarray) -> np.ndarray:
    """White spheres on black."""
    return np.where(caps(SPHERES, 0.5)(at) > 0.05, 0.8, 0.03)


@pytest.fixture(scope="module")
def calibration(tmp_path_factory):
    """The exact camera and light plane of the drawn sweeps, and one whose speed is 1 % too high."""
    folder = tmp_path_factory.mktemp("exact")
    speed = A / (A @ A) / 10
    for name, factor in (("exact", 1.0), ("fast", 1.01)):
        normal = (A / np.linalg.norm(A)).tolist()
        plane = {
            "kind": "translating", "parameter": "position_um", "method": "auto", "normal": normal,
            "corner_origin_mm": (-450 * speed).tolist(), "corner_velocity_mm": (factor * speed).tolist(),
        }  # fmt: skip
        write_document(folder / f"{name}.json", new_document(msgspec.structs.asdict(PINHOLE.model()), plane))
    return folder


def check(calibration_file, scan, *arguments: str) -> tuple[bool, dict[str, float]]:
    everything = ["calibrate", "check", str(scan), "--calibration", str(calibration_file), *arguments, "--json"]
    result = CliRunner().invoke(cli, everything, standalone_mode=False)
    if result.exception is not None:
        raise result.exception
    found = json.loads(result.stdout)
    assert result.return_value == (0 if found["passed"] else 1)
    return found["passed"], {figure["name"]: figure["value"] for figure in found["figures"]}


def test_two_spheres_in_a_sweep_give_the_probing_and_spacing_errors(calibration, tmp_path):
    scan = sweep(tmp_path / "spheres", bright_on_top, FLAT, AT, height=caps(SPHERES, 0.5), light=Light(room=0.05))
    spacing = float(np.linalg.norm([2.3, 0.2, 0.2]))
    known = ["--sphere-mm", "2.0", "--sphere-mm", "1.6", "--spacing-mm", str(spacing)]
    passed, figures = check(calibration / "exact.json", scan, *known, "--limit-um", "40")
    assert passed
    assert abs(figures["sphere of 2 mm: probing error, size"]) < 4
    assert abs(figures["sphere of 1.6 mm: probing error, size"]) < 4
    assert abs(figures["sphere-spacing error"]) < 3
    passed, figures = check(calibration / "fast.json", scan, *known, "--limit-um", "10")
    assert not passed
    assert abs(figures["sphere-spacing error"]) > 2


def test_a_flat_that_bulges_fails_by_its_flatness_error(calibration, tmp_path):
    bent = sweep(tmp_path / "bent", white, FLAT, AT, height=bulge(0.01))
    passed, figures = check(calibration / "exact.json", bent, "--limit-um", "20")
    assert not passed
    assert figures["flatness error"] > 40


def test_the_board_shows_the_scale_and_a_second_sweep_the_repeatability(calibration, tmp_path):
    scans = [sweep(tmp_path / name, chessboard(BOARD), FLAT, AT, seed=seed) for name, seed in (("one", 1), ("two", 2))]
    squares = ["--squares", "13x10", "--square-mm", "0.3", "--again", str(scans[1])]
    _, figures = check(calibration / "exact.json", scans[0], *squares)
    assert abs(figures["scale against the board's squares"]) < 0.15
    assert abs(figures["shift between the sweeps"]) < 0.2
    assert 0 < figures["repeatability of a point (standard deviation)"] < 2
    wrong = ["--squares", "13x10", "--square-mm", "0.303"]
    assert check(calibration / "exact.json", scans[0], *wrong)[1]["scale against the board's squares"] < -0.5


def test_a_cloud_without_anything_round_is_said_so():
    x, y = np.meshgrid(np.linspace(-1, 1, 80), np.linspace(-1, 1, 80))
    with pytest.raises(CalibrationError, match="no sphere was found"):
        find_spheres(np.stack([x, y, 0.1 * x], axis=-1))


def test_wild_points_do_not_move_a_sphere():
    generator = np.random.default_rng(1)
    direction = generator.normal(size=(4000, 3)) * [1, 1, 0.5] + [0, 0, 1.5]
    points = direction / np.linalg.norm(direction, axis=1)[:, None] + [3.0, 2.0, 1.0]
    points[:300] += generator.normal(0, 0.3, (300, 3))
    found = fit_sphere(points)
    assert found is not None
    assert found.radius_mm == pytest.approx(1.0, abs=1e-3)
    assert found.centre == pytest.approx([3.0, 2.0, 1.0], abs=1e-3)


def test_fewer_spheres_than_given_are_named():
    with pytest.raises(CalibrationError, match="0 spheres were found, 1 were given"):
        sphere_figures([], [2.0], None, CheckConfig())


def test_two_sweeps_of_different_things_do_not_repeat():
    nothing = np.full((20, 20, 3), np.nan)
    with pytest.raises(CalibrationError, match="are they of the same thing"):
        repeatability(nothing, nothing)
