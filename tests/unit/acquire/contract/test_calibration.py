"""calibration.json: what is accepted, and what is refused by name."""

from __future__ import annotations

import copy
import json

import msgspec
import pytest

from acquire.contract.calibration import age_days, check_size, check_validity, load_calibration, parse_calibration
from acquire.contract.errors import CalibrationError
from acquire.contract.plan import SweepPlan

GOOD = {
    "format": "sweepscope-calibration",
    "version": 1,
    "camera": {
        "width": 64,
        "height": 48,
        "K": [[700.0, 0, 32], [0, 700, 24], [0, 0, 1]],
        "R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
        "T": [0, 0, 77],
    },
    "light_plane": {
        "kind": "translating",
        "parameter": "position_um",
        "normal": [-0.55, 0.0, 0.84],
        "corner_origin_mm": [0, 0, 0],
        "corner_velocity_mm": [-0.001, 0, 0],
    },
}
PLAN = SweepPlan(first_steps=0, last_steps=30, steps_per_frame=3, um_per_microstep=3.175)


def changed(**changes):
    found = copy.deepcopy(GOOD)
    for path, value in changes.items():
        *parents, key = path.split("__")
        place = found
        for parent in parents:
            place = place[parent]
        if value is KeyError:
            del place[key]
        else:
            place[key] = value
    return json.dumps(found)


def test_optional_keys_have_defaults_and_unknown_ones_are_allowed():
    calibration = parse_calibration(changed(note="mine", camera__rms_px=0.1))
    assert calibration.camera.distortion == (0, 0, 0, 0, 0)
    assert calibration.light_plane is not None and calibration.light_plane.edge == "rising"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera__K": KeyError}, r"camera\.K is missing"),
        ({"camera__T": [0, 0, float("nan")]}, "NaN"),
        ({"camera__T": [0, 0, 1e999]}, "Infinity"),
        ({"camera__R": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}, "no rotation"),
        ({"camera__R": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "no rotation"),
        ({"camera__K": [[-7, 0, 3], [0, 7, 3], [0, 0, 1]]}, "camera matrix"),
        ({"light_plane__normal": [0, 0, 0]}, "normal is zero"),
        ({"light_plane__corner_velocity_mm": [0, 1, 0]}, "never move"),
        ({"light_plane__kind": "bent"}, "light_plane"),
        ({"light_plane__parameter": KeyError}, "parameter is missing"),
        ({"format": "another"}, "format"),
        ({"version": 2}, "version"),
        ({"camera__width": "wide"}, r"camera\.width"),
    ],
)
def test_what_cannot_be_meant_is_refused_by_name(changes, words):
    with pytest.raises(CalibrationError, match=words):
        parse_calibration(changed(**changes))


@pytest.mark.parametrize("text", ["", "{", "[1]", "nul", "[" * 100_000])
def test_what_is_no_json_object_is_refused(text):
    with pytest.raises(CalibrationError):
        parse_calibration(text)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(CalibrationError, match="away.json is not there"):
        load_calibration(tmp_path / "away.json")


def test_another_image_size_is_refused_and_both_are_named():
    with pytest.raises(CalibrationError, match="64 x 48.*1024 x 768"):
        check_size(parse_calibration(json.dumps(GOOD)), 1024, 768)


def test_frame_numbers_of_another_sweep_are_refused():
    text = changed(light_plane__parameter="frame", valid_for={"first_steps": 0, "steps_per_frame": 6, "direction": 1})
    with pytest.raises(CalibrationError, match="steps per frame 6"):
        check_validity(parse_calibration(text), PLAN)


def test_positions_in_um_are_valid_for_any_sweep():
    text = changed(valid_for={"first_steps": 0, "steps_per_frame": 6, "direction": 1})
    assert check_validity(parse_calibration(text), PLAN) == []


def test_a_new_zero_is_warned_of():
    calibration = parse_calibration(changed(valid_for={"zero_id": "a"}))
    assert "homed" in check_validity(calibration, PLAN, "b")[0]


def test_the_real_calibration_is_accepted(real_scan):
    calibration, text = load_calibration(real_scan / "calibration.json")
    assert msgspec.json.decode(text)["light_plane"]["first_frame"] == 47
    assert calibration.light_plane.last_frame == 149


def test_a_calibration_that_is_older_than_meant_is_warned_of_with_its_age():
    calibration = parse_calibration(changed(valid_for={"created_utc": "2026-01-01T00:00:00Z", "days": 30}))
    assert check_validity(calibration, PLAN, at_utc="2026-01-20T00:00:00Z") == []
    assert check_validity(calibration, PLAN, at_utc="2026-02-15T00:00:00Z") == [
        "the calibration is 45 days old and meant for 30: check it"
    ]


def test_an_age_needs_both_times():
    calibration = parse_calibration(changed(valid_for={"created_utc": "yesterday"}))
    assert age_days(calibration, "2026-01-20T00:00:00Z") is None
    assert age_days(calibration, "") is None
