"""The overlap check: noise is accepted; a shift of 3 microsteps or a specimen moved by 5 um is not."""

from __future__ import annotations

import numpy as np
import pytest

from acquire.contract.config.simulation import SimulationConfig
from acquire.simulation import Renderer, build_scene
from acquire.sweep.checks.overlap import compare_overlap, overlap_complaint, overlap_picture
from acquire.sweep.settings import OverlapLimits

WIDTH, HEIGHT, PITCH, FRAME = 256, 192, 3, 240
LIMITS = OverlapLimits(specimen_px=2.5 / 26.6)
"""A pixel is 26.6 um wide at this size."""


def renderer(**changes):
    config = SimulationConfig(retake_noise=True, **changes)
    scene = Renderer(build_scene(config, width=WIDTH, height=HEIGHT, um_per_microstep=3.175))
    return lambda steps, attempt=0: scene.render(steps, exposure_ms=30, gain=6, brightness=0, attempt=attempt)


@pytest.fixture(scope="module")
def stored():
    render = renderer()
    return render(PITCH * FRAME), render(PITCH * (FRAME - 1))


def compare(stored, retaken):
    return compare_overlap(stored[0], retaken, stored[1], PITCH)


def test_other_noise_at_the_same_place_is_accepted(stored):
    for attempt in range(1, 6):
        assert overlap_complaint(compare(stored, renderer()(PITCH * FRAME, attempt)), LIMITS) == ""


@pytest.mark.parametrize("shift_steps", [-3, 3, -12, 12, 60])
def test_a_shift_of_three_microsteps_is_refused(stored, shift_steps):
    found = compare(stored, renderer()(PITCH * FRAME + shift_steps, 1))
    assert "microsteps" in overlap_complaint(found, LIMITS)
    if abs(shift_steps) == 3:
        assert found["overlap_stage_steps"] == pytest.approx(shift_steps, abs=1.0)


@pytest.mark.parametrize("moved_um", [(5.0, 0.0, 0.0), (0.0, 5.0, 0.0), (0.0, 0.0, 5.0), (-5.0, 0.0, 0.0)])
def test_a_specimen_that_moved_by_5_um_is_refused(stored, moved_um):
    found = compare(stored, renderer(specimen_moved_um=moved_um)(PITCH * FRAME, 1))
    assert overlap_complaint(found, LIMITS)


def test_a_change_of_the_light_is_refused(stored):
    dimmed = (stored[0] * 0.9).astype(np.uint8)
    assert "light changed by -" in overlap_complaint(compare(stored, dimmed), LIMITS)


def test_frame_0_has_no_neighbour_and_is_compared_without_one(stored):
    found = compare_overlap(stored[0], stored[0], None, PITCH)
    names = ("overlap_specimen_px", "overlap_brightness_change", "overlap_rms_counts")
    assert found == {name: pytest.approx(0) for name in names}


def test_the_picture_shows_both_frames_and_their_difference(stored):
    picture = overlap_picture(stored[0], renderer()(PITCH * FRAME + 30, 1))
    assert picture.shape == (HEIGHT, 3 * WIDTH, 3) and picture.dtype == np.uint8
    assert picture[:, 2 * WIDTH :].max() > 160
