"""Files of the original program: the paper's printed numbers give the same points under both conventions."""

from __future__ import annotations

import json

import cv2
import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from plyfile import PlyData

from acquire.contract.calibration import load_calibration
from acquire.contract.errors import CalibrationError
from process.calibration.original_program import pattern_normal, read_calibration_txt, read_projector_txt
from process.cloud.light_planes import plane_table
from process.cloud.triangulation import Hits, intersect, rays
from tui.cli import cli

K = np.array([[11560.0, 0.0, 692.1], [0.0, 11530.0, 591.6], [0.0, 0.0, 1.0]])
R = np.array([[0.9998, 0.001851, 0.02065], [-0.002296, 0.9998, 0.02157], [-0.02061, -0.02162, 0.9996]])
T = np.array([-2.049, -2.543, 76.88])
NORMAL = np.array([-0.5461, -0.0055, 0.8377])
VELOCITY, ORIGIN = np.array([-0.00939, 0.00087, 0.0]), np.array([0.2851, -1.224, 0.0])


def block(values: np.ndarray) -> str:
    rows = np.atleast_2d(values)
    return "\n".join("\t".join(str(value) for value in row) for row in rows)


@pytest.fixture
def files(tmp_path):
    text = f"Intrinsic Matrix K:\n{block(K)}\nDistortion:\n0 0 0 0\nRotation:\n{block(R)}\nTranslation:\n{block(T)}\n"
    (tmp_path / "calibration.txt").write_text(text)
    seen = [to_pixel(place) for place in (ORIGIN + VELOCITY, ORIGIN + 527 * VELOCITY)]
    pattern = [to_pixel(place) for place in ([1.0, -1.0, 0.0], [-2.0, -1.0, 0.0], [-2.0, -2.9, 0.0])]
    lines = [f"Frame {k}\t{x} {y}" for k, (x, y) in zip((1, 527), seen, strict=True)]
    lines.append("Calibration Corners:\t" + "\t ".join(f"{x} {y}" for x, y in pattern))
    (tmp_path / "projector.txt").write_text("\n".join(lines) + "\n")
    return tmp_path


def to_pixel(place) -> np.ndarray:
    seen = K @ np.linalg.solve(R, np.asarray(place) - T)
    return seen[:2] / seen[2]


def original_point(pixel: np.ndarray, normal: np.ndarray, q: np.ndarray) -> np.ndarray:
    """The original's own arithmetic: u = T, v = R K^-1 p' (camera to world)."""
    v = R @ np.linalg.solve(K, [*pixel, 1.0])
    return T + (normal @ (q - T)) / (normal @ v) * v


def test_the_printed_numbers_give_the_same_points_under_both_conventions(files):
    out = files / "c.json"
    arguments = ["calibrate", "import-original", str(files / "calibration.txt"), "--out", str(out)]
    run = CliRunner().invoke(cli, arguments, standalone_mode=False)
    assert run.exception is None, run.exception
    document = json.loads(out.read_text())
    document["light_plane"] = {
        "kind": "translating",
        "parameter": "frame",
        "normal": NORMAL.tolist(),
        "corner_origin_mm": ORIGIN.tolist(),
        "corner_velocity_mm": VELOCITY.tolist(),
    }
    out.write_text(json.dumps(document))
    found = load_calibration(out)[0]
    pixels = np.array([[0.0, 0.0], [1023.0, 767.0], [500.0, 300.0]])
    crossing = np.array([20.0, 480.0, 250.25])
    hits = Hits(np.arange(3), crossing, np.full(3, 0.1, np.float32))
    points, _ = intersect(
        rays(found.camera, pixels), plane_table(found.light_plane), np.arange(1, 528, dtype=np.float64), hits
    )
    for pixel, index, point in zip(pixels, crossing, points, strict=True):
        wanted = original_point(pixel, NORMAL, ORIGIN + VELOCITY * (index + 1))
        assert np.abs(point - wanted).max() < 1e-9


def test_the_corner_track_goes_through_the_two_clicked_corners(files):
    arguments = ["calibrate", "import-original", str(files / "calibration.txt"), "--projector"]
    arguments += [str(files / "projector.txt"), "--out", str(files / "c.json")]
    assert CliRunner().invoke(cli, arguments, standalone_mode=False).exception is None
    plane = load_calibration(files / "c.json")[0].light_plane
    assert plane.corner_velocity_mm == pytest.approx(VELOCITY, abs=1e-9)
    assert plane.corner_origin_mm == pytest.approx(ORIGIN, abs=1e-8)
    assert plane.velocity_direction == "corner-track"


def test_an_edge_shorter_than_the_optics_allow_is_impossible_and_said_with_the_number():
    with pytest.raises(CalibrationError, match=r"hp / d = 1\.862 > 1"):
        pattern_normal(np.array([1.0, 0, 0]), np.zeros(3), np.array([0, -1.0, 0]), VELOCITY)


def test_a_calibration_that_ends_early_names_what_is_missing(tmp_path):
    (tmp_path / "calibration.txt").write_text(f"K:\n{block(K)}\nDistortion:\n0 0 0 0\n")
    with pytest.raises(CalibrationError, match="ends before its rotation"):
        read_calibration_txt(tmp_path / "calibration.txt")


def test_a_projector_file_without_the_pattern_is_refused(tmp_path):
    (tmp_path / "projector.txt").write_text("Frame 1\t1 2\nFrame 527\t3 4\n")
    with pytest.raises(CalibrationError, match="lacks the calibration corners"):
        read_projector_txt(tmp_path / "projector.txt")


def test_a_folder_of_the_original_program_becomes_the_points_that_it_would_have_made(files):
    """Bitmaps, projector.txt and calibration.txt in; points against the original's own arithmetic."""
    frames = files / "sequence01"
    frames.mkdir()
    (frames / "projector.txt").write_text((files / "projector.txt").read_text())
    column = np.tile(np.arange(64.0), (48, 1))
    crossing = 6 + 0.25 * column
    for number in range(1, 31):
        share = np.clip(number - crossing + 0.5, 0, 1)
        cv2.imwrite(str(frames / f"frame{number:04d}.bmp"), np.rint(20 + 200 * share).astype(np.uint8))
    calibration, scan = str(files / "c.json"), str(files / "scan.h5")
    out = ["--size", "64x48", "--out", calibration]
    projector = ["--projector", str(frames / "projector.txt")]
    for arguments in (
        ["import", str(frames), scan],
        ["calibrate", "import-original", str(files / "calibration.txt"), *projector, *out],
        ["reconstruct", scan, "--calibration", calibration, "--method", "linear", "--median", "0"],
    ):
        assert CliRunner().invoke(cli, arguments, standalone_mode=False).exception is None
    plane = json.loads((files / "c.json").read_text())["light_plane"]
    with h5py.File(files / "maps.h5") as maps:
        found = maps["crossing"][...]
    cloud = PlyData.read(files / "cloud.ply")["vertex"]
    pixels = np.argwhere(np.isfinite(found))
    assert len(pixels) == len(cloud) > 1000
    for index in (0, len(pixels) // 2, len(pixels) - 1):
        row, column_ = pixels[index]
        q = np.array(plane["corner_origin_mm"]) + np.array(plane["corner_velocity_mm"]) * (found[row, column_] + 1)
        wanted = original_point(np.array([column_, row], dtype=float), np.array(plane["normal"]), q)
        assert [cloud[axis][index] for axis in "xyz"] == pytest.approx(wanted, abs=2e-5)
