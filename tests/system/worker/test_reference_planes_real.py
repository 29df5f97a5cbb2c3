"""Light planes of a real hand-swept shadow, from its pictures and the markers on floor and wall."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.accuracy.reference_planes import spread
from tui.cli import run

SECOND = "frog-v2-lr"


@pytest.fixture(scope="module")
def second_scan(real_scan: Path) -> Path:
    folder = real_scan.parent / SECOND
    if not folder.is_dir():
        pytest.skip(f"the second real scan is not in {folder}: set SWEEPSCOPE_TEST_DATA")
    return folder


def test_a_whole_sweep_gets_its_planes_and_little_noise(real_scan: Path, second_scan: Path, tmp_path: Path) -> None:
    scan, camera, made = tmp_path / "scan.h5", tmp_path / "camera.json", tmp_path / "planes.json"
    board = ["--squares", "9x7", "--square-mm", "30"]
    planes = second_scan / "planes.json"
    assert run(["import", str(second_scan / "frames"), str(scan)]) == 0
    assert run(["calibrate", "camera", str(real_scan / "checkerboard"), *board, "--out", str(camera)]) == 0
    command = ["calibrate", "reference-planes", str(scan), "--camera", str(camera), "--planes", str(planes)]
    assert run([*command, "--edge", "falling", "--out", str(made)]) == 0
    light = json.loads(made.read_text())["light_plane"]
    numbers = {light["first_frame"] + k for k, plane in enumerate(light["planes"]) if plane is not None}
    assert len(numbers & set(range(40, 191))) >= 145
    assert light["quality"]["skew_median_mm"] < 0.6
    assert max(value for value in light["quality"]["skew_mm"] if value is not None) < 5
    assert run(["reconstruct", str(scan), "--calibration", str(made), "--edge", "falling", "--contrast", "50",
                "--median", "0", "--method", "auto"]) == 0  # fmt: skip
    found, points = spread(tmp_path, made, planes)
    assert found["wall"].about_fit_mm < 1.35 and found["floor"].about_fit_mm < 0.80
    assert points > 130_000
