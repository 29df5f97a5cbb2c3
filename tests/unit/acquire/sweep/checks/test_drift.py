"""Drift between frame 0 and its repetition."""

from __future__ import annotations

import numpy as np
import pytest

from acquire.sweep.checks.drift import measure_drift

RANDOM = np.random.default_rng(3)
SCENE = np.kron(RANDOM.integers(20, 200, (16, 16)), np.ones((8, 8))).astype(np.uint8)


def test_frames_that_are_equal_show_no_drift():
    found = measure_drift(SCENE, SCENE)
    assert found == {"brightness_change": 0.0, "drift_px": pytest.approx(0, abs=1e-3)}


def test_a_shift_is_measured_in_pixels():
    assert measure_drift(SCENE, np.roll(SCENE, 3, axis=1))["drift_px"] == pytest.approx(3, abs=0.2)


def test_a_dimmer_lamp_is_measured_in_colour_frames_too():
    colour = np.repeat(SCENE[..., None], 3, axis=2)
    dimmed = (colour * 0.9).astype(np.uint8)
    assert measure_drift(colour, dimmed)["brightness_change"] == pytest.approx(-0.1, abs=0.01)


def test_frames_without_structure_yield_no_shift_rather_than_a_wrong_one():
    flat = np.full((64, 64), 7, np.uint8)
    assert "drift_px" not in measure_drift(flat, flat)
