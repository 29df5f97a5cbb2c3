"""Flag > recorded > calibration > default, and everything that is refused by name."""

from __future__ import annotations

import json

import pytest

from acquire.contract.errors import CalibrationError, ConfigError, ScanFileError
from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.plan import SweepPlan
from process.results.settings import ReconstructOptions, Recorded, settle
from tests.fakes.processes.sweep_source import calibration_json

FORM = FrameFormat(width=64, height=48, bit_depth=8)
CALIBRATION = calibration_json(64, 48)


def changed(**plane) -> str:
    found = json.loads(CALIBRATION)
    found["light_plane"] |= plane
    return json.dumps(found)


def test_without_anything_the_documented_defaults_hold():
    found = settle(Recorded(FORM), ReconstructOptions())
    assert (found.contrast, found.median, found.edge, found.method) == (70, 5, "rising", "auto")
    assert found.calibration is None and "no calibration" in found.what_is_missing


def test_what_the_scan_recorded_beats_the_default():
    found = settle(Recorded(FORM, config_toml="[reconstruct]\ncontrast = 33\nmedian = 0\n"), ReconstructOptions())
    assert (found.contrast, found.median) == (33, 0)


def test_a_flag_beats_what_the_scan_recorded():
    recorded = Recorded(FORM, config_toml="[reconstruct]\ncontrast = 33\nmedian = 0\n")
    found = settle(recorded, ReconstructOptions(contrast=44, median=3))
    assert (found.contrast, found.median) == (44, 3)


def test_contrast_zero_and_median_zero_as_flags_are_meant():
    recorded = Recorded(FORM, config_toml="[reconstruct]\ncontrast = 33\nmedian = 3\n")
    found = settle(recorded, ReconstructOptions(contrast=0, median=0))
    assert (found.contrast, found.median) == (0, 0)


def test_recorded_keys_of_another_version_are_ignored():
    recorded = Recorded(FORM, config_toml="[reconstruct]\ncontrast = 33\nlater = 1\n[future]\nx = 1\n")
    assert settle(recorded, ReconstructOptions()).contrast == 33


def test_the_edge_comes_from_the_calibration():
    found = settle(Recorded(FORM, calibration_json=changed(edge="falling")), ReconstructOptions())
    assert found.edge == "falling" and found.what_is_missing == ""


def test_the_edge_flag_decides_where_there_is_no_light_plane():
    assert settle(Recorded(FORM), ReconstructOptions(edge="falling")).edge == "falling"


def test_an_edge_that_contradicts_the_calibration_is_refused_with_a_way_out():
    recorded = Recorded(FORM, calibration_json=CALIBRATION)
    with pytest.raises(CalibrationError, match=r"--edge falling contradicts .* rising edge.*--force"):
        settle(recorded, ReconstructOptions(edge="falling"))


def test_force_takes_the_edge_and_warns():
    recorded = Recorded(FORM, calibration_json=CALIBRATION)
    found = settle(recorded, ReconstructOptions(edge="falling", force=True))
    assert found.edge == "falling" and "although" in found.warnings[0]


def test_a_calibration_flag_beats_the_recorded_calibration(tmp_path):
    (tmp_path / "c.json").write_text(changed(edge="falling"))
    recorded = Recorded(FORM, calibration_json=CALIBRATION)
    assert settle(recorded, ReconstructOptions(calibration=tmp_path / "c.json")).edge == "falling"


def test_a_calibration_of_another_size_is_refused_even_with_force():
    recorded = Recorded(FORM, calibration_json=calibration_json(128, 96))
    with pytest.raises(CalibrationError, match="128 x 96 pixels, the scan has 64 x 48"):
        settle(recorded, ReconstructOptions(force=True))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (CALIBRATION.replace("77", "NaN"), "NaN"),
        (CALIBRATION.replace('"normal"', '"nrml"'), "normal is missing"),
        (CALIBRATION.replace("[-0.546, -0.0055, 0.838]", "[0, 0, 0]"), "normal is zero"),
        ("{", "not valid JSON"),
    ],
)
def test_a_damaged_calibration_is_refused_by_name(text, named):
    with pytest.raises(CalibrationError, match=named) as caught:
        settle(Recorded(FORM, calibration_json=text), ReconstructOptions())
    assert "\n" not in str(caught.value)


def test_a_calibration_that_is_not_there_is_named(tmp_path):
    with pytest.raises(CalibrationError, match="gone.json is not there"):
        settle(Recorded(FORM), ReconstructOptions(calibration=tmp_path / "gone.json"))


def test_a_plane_by_frame_numbers_of_another_sweep_is_refused_unless_forced():
    found = json.loads(changed(parameter="frame", corner_velocity_mm=[-0.0094, 0, 0]))
    found["valid_for"] = {"first_steps": 0, "steps_per_frame": 3, "direction": 1}
    recorded = Recorded(FORM, SweepPlan(0, 100, 4, 3.175), calibration_json=json.dumps(found))
    with pytest.raises(CalibrationError, match="steps per frame 3 \\(here 4\\).*--force"):
        settle(recorded, ReconstructOptions())
    assert "forced" in settle(recorded, ReconstructOptions(force=True)).warnings[0]


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (ReconstructOptions(contrast=256), "contrast.*256"),
        (ReconstructOptions(contrast=-1), "contrast.*-1"),
        (ReconstructOptions(median=4), "median must be odd.*4"),
        (ReconstructOptions(method="spline"), "method.*spline"),
    ],
)
def test_a_flag_out_of_bounds_is_refused_by_name(options, named):
    with pytest.raises(ConfigError, match=named):
        settle(Recorded(FORM), options)


def test_a_recorded_configuration_that_is_no_toml_is_a_damaged_scan():
    with pytest.raises(ScanFileError, match="configuration recorded in the scan"):
        settle(Recorded(FORM, config_toml="= what"), ReconstructOptions())
