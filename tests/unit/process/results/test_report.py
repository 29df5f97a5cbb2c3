"""What report.json says, and that it says it honestly."""

from __future__ import annotations

import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from acquire.contract.calibration import PerFramePlanes, TranslatingPlane
from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.plan import SweepPlan
from acquire.contract.scan_data.report_file import NoiseFound, Speed
from process.cloud.cloud import PointCloud
from process.edge_fit.noise_model import NoiseModel
from process.results.report import (
    age_warnings,
    calibration_used,
    contrast_histogram,
    noise_found,
    quality_warnings,
    sweep_speed,
    truth_errors,
)
from process.results.settings import ReconstructOptions, Recorded, Settings, settle
from process.results.timings import Timings
from tests.fakes.processes.sweep_source import calibration_json

PLAN = SweepPlan(0, 30, 3, 3.175)


def plane(parameter: str, mm_per_unit: float, direction: str) -> TranslatingPlane:
    return TranslatingPlane(
        parameter, (-0.5, 0.0, 0.8), (0.0, 0.0, 0.0), (-mm_per_unit, 0.0, 0.0), velocity_direction=direction
    )


def test_speed_by_frames_is_compared_with_the_command():
    found = sweep_speed(PLAN, plane("frame", 0.00943, "corner-track"))
    assert found.commanded_um_per_frame == pytest.approx(9.525)
    assert found.calibrated_um_per_frame == pytest.approx(9.43)
    assert found.ratio == pytest.approx(9.43 / 9.525)


def test_speed_by_position_is_brought_to_the_frame():
    found = sweep_speed(PLAN, plane("position_um", 0.00099, "assumed-axis"))
    assert found.calibrated_um_per_frame == pytest.approx(0.99 * 9.525)
    assert found.ratio == pytest.approx(0.99)


@pytest.mark.parametrize(
    "light_plane",
    [None, plane("frame", 0.009, "normal"), PerFramePlanes("frame", 1, ((0.0, 0.0, 1.0, 0.0),))],
)
def test_a_speed_whose_direction_is_not_known_is_not_determinable(light_plane):
    assert sweep_speed(PLAN, light_plane) == Speed(commanded_um_per_frame=pytest.approx(9.525))


def test_an_imported_scan_has_no_commanded_speed():
    assert sweep_speed(None, plane("position_um", 0.001, "corner-track")) == Speed()
    assert sweep_speed(None, plane("frame", 0.009, "corner-track")).ratio is None


def test_the_histogram_counts_in_8_bit_whatever_the_depth():
    low, high = np.zeros((1, 3), np.uint16), np.array([[0, 16, 4095]], np.uint16)
    found = contrast_histogram(low, high, 12)
    assert len(found) == 256 and (found[0], found[1], found[255]) == (1, 1, 1)


def write_truth(path: Path, points: np.ndarray, visible: list[int], amplitude: list[float]) -> None:
    with h5py.File(path, "w") as file:
        file["points"], file["visible"] = points.reshape(1, -1, 3), np.array([visible], np.uint8)
        file["amplitude"] = np.array([amplitude])


def cloud_at(points: np.ndarray, pixels: list[int]) -> PointCloud:
    n = len(pixels)
    return PointCloud(points, np.zeros((n, 3), np.uint8), np.zeros(n, np.float32), np.zeros(n), np.zeros(n, np.uint16),
                 np.array(pixels, np.intp))  # fmt: skip


def test_errors_are_over_all_points_untrimmed_with_the_share_beside_them(tmp_path):
    truth = np.zeros((5, 3))
    truth[4] = np.nan
    write_truth(tmp_path / "truth.h5", truth, [1, 1, 1, 0, 1], [100, 100, 100, 100, 10])
    off_mm = np.array([[0.001, 0, 0], [0, 0.002, 0], [0, 0, 0.1], [1, 1, 1]])
    found = truth_errors(tmp_path / "truth.h5", cloud_at(off_mm, [0, 1, 3, 4]), contrast=70)
    assert (found.points, found.points_beside) == (3, 1)
    assert found.median_um == pytest.approx(2.0)
    assert found.rms_um == pytest.approx(np.sqrt((1 + 4 + 1e4) / 3))
    assert (found.visible_over_contrast, found.reconstructed) == (3, 2)
    assert found.share == pytest.approx(2 / 3)


def test_no_points_have_no_errors_and_a_share_of_zero(tmp_path):
    write_truth(tmp_path / "truth.h5", np.zeros((2, 3)), [1, 1], [100, 100])
    found = truth_errors(tmp_path / "truth.h5", cloud_at(np.zeros((0, 3)), []), contrast=70)
    assert (found.median_um, found.share) == (None, 0.0)


def test_a_truth_of_another_image_is_refused(tmp_path):
    write_truth(tmp_path / "truth.h5", np.zeros((2, 3)), [1, 1], [100, 100])
    with pytest.raises(ScanFileError, match="smaller image"):
        truth_errors(tmp_path / "truth.h5", cloud_at(np.zeros((1, 3)), [7]), contrast=70)


def test_a_damaged_truth_is_named(tmp_path):
    (tmp_path / "truth.h5").write_text("no")
    with pytest.raises(ScanFileError, match=r"truth\.h5"):
        truth_errors(tmp_path / "truth.h5", cloud_at(np.zeros((0, 3)), []), contrast=70)


def test_the_stages_of_a_reconstruction_are_timed_by_clock_and_processor():
    timings = Timings()
    for _ in range(2):
        with timings.stage("fold"):
            sum(range(1000))
    clock, processor = timings.rounded()
    assert set(clock) == set(processor) == {"fold"} and clock["fold"] > 0 and processor["fold"] >= 0


FOUND = {
    "over_contrast": 1000,
    "past_s_in_first": 0,
    "crossings": 1000,
    "saturated": 0,
    "plateau_not_reached": 0,
    "no_dark_level": 0,
    "lit_at_start": 0,
}
FOUND |= {"several": 0, "filtered": 0}


def test_a_scan_without_peculiarities_is_not_warned_of():
    assert quality_warnings(FOUND, NoiseFound(1.0, 0.0, measured=True)) == []


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("saturated", "less exposure"),
        ("plateau_not_reached", "sweep further"),
        ("no_dark_level", "stray light"),
        ("lit_at_start", "begin the sweep earlier"),
        ("several", "reflections"),
        ("filtered", "more light"),
    ],
)
def test_what_many_pixels_have_in_common_is_said_in_words(name, word):
    (said,) = quality_warnings(FOUND | {name: 123}, None)
    assert said.startswith("123 pixels (12.3 % of those over the contrast)") and word in said


def test_a_shadow_needs_no_dark():
    assert quality_warnings(FOUND | {"no_dark_level": 500}, None, edge="falling") == []


@pytest.mark.parametrize(("edge", "other"), [("rising", "falling"), ("falling", "rising")])
def test_pixels_that_begin_beyond_half_brightness_point_to_the_other_edge(edge, other):
    found = FOUND | {"crossings": 1, "past_s_in_first": 999, "lit_at_start": 999}
    (said,) = quality_warnings(found, None, edge=edge)
    assert f"--edge {other}" in said and "begin the sweep earlier" not in said


def test_no_share_is_beyond_a_hundred_percent():
    found = FOUND | {"crossings": 1} | dict.fromkeys(("saturated", "no_dark_level", "lit_at_start"), 1000)
    shares = [float(share) for share in re.findall(r"\(([\d.]+) %", " ".join(quality_warnings(found, None)))]
    assert shares and max(shares) <= 100


def test_noise_that_was_not_measured_is_said():
    (said,) = quality_warnings(FOUND, NoiseFound(2.0, 0.0, measured=False))
    assert "noise_counts, 2 counts" in said


def test_the_noise_of_a_falling_edge_is_that_of_the_frames():
    rising = noise_found(NoiseModel(4.0 + 1 / 12, 0.05, measured=True), 0)
    falling = noise_found(NoiseModel(4.0 + 1 / 12 + 0.05 * 255, -0.05, measured=True), 255)
    assert rising.read == pytest.approx(2.0) and rising.shot == 0.05
    assert falling.read == pytest.approx(2.0) and falling.shot == pytest.approx(0.05)


def calibrated(created: str | None, days: float | None) -> Settings:
    text = calibration_json(64, 48)
    valid = {"valid_for": {"created_utc": created, "days": days}}
    document = json.dumps(json.loads(text) | valid)
    form = FrameFormat(width=64, height=48, bit_depth=8)
    return settle(Recorded(form, PLAN, "", document), ReconstructOptions())


def test_the_calibration_used_has_an_age_and_an_old_one_is_warned_of():
    settings = calibrated("2026-01-01T00:00:00Z", 30.0)
    used = calibration_used(settings, "2026-02-10T12:00:00Z")
    assert used is not None and used.source == "the scan" and len(used.sha256) == 64
    assert used.age_days == 40.5
    (said,) = age_warnings(settings, used)
    assert "40 days old" in said and "meant for 30" in said
    assert age_warnings(settings, calibration_used(settings, "2026-01-20T00:00:00Z")) == []


@pytest.mark.parametrize("created", [None, "yesterday", "2026-01-01T00:00:00"])
def test_a_calibration_of_unknown_age_has_none(created):
    used = calibration_used(calibrated(created, 30.0), "2026-02-10T12:00:00Z")
    assert used is not None and used.age_days is None
