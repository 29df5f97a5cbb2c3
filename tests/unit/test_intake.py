"""Frames that overtake the word of their trigger: kept for it where a clock will tell, and never guessed."""

from __future__ import annotations

import numpy as np
import pytest

from acquire.cameras.protocol import CameraFrame
from acquire.intake import Intake
from acquire.shooting import Shooting
from acquire.stages.protocol import Triggered
from acquire.window import Window

from .sweep_bench import MS, settings

NOW_NS = 5000 * MS


def frame(camera_frame_id: int, camera_ms: int) -> CameraFrame:
    return CameraFrame(np.ones((4, 5), np.uint8), camera_frame_id, 0, camera_ms * MS)


@pytest.fixture
def intake() -> Intake:
    shooting = Shooting(settings(), Window(100))
    shooting.begin(0, 9, NOW_NS)
    return Intake(shooting)


def fire(intake: Intake, shot_index: int, fired_ms: int, now_ns: int) -> list[CameraFrame]:
    event = Triggered(shot_index, shot_index, 30 + 3 * shot_index, fired_ns=fired_ms * MS)
    assert intake.triggered(event, now_ns, check=False) == ""
    return intake.early(now_ns)


def test_a_frame_that_overtakes_the_word_of_its_trigger_is_taken_when_that_comes(intake):
    assert intake.is_early(frame(7, 300), NOW_NS)
    (kept,) = fire(intake, 0, 100, NOW_NS + 20 * MS)
    found = intake.pair(kept, was_early=True)
    assert found.shot is not None and found.shot.frame_index == 0


def test_of_two_frames_before_the_first_trigger_none_is_taken_for_its_own(intake):
    assert intake.is_early(frame(7, 250), NOW_NS) and intake.is_early(frame(8, 300), NOW_NS)
    assert fire(intake, 0, 100, NOW_NS + 20 * MS) == []
    assert intake.counters["extra"] == 2


def test_of_two_frames_before_a_later_trigger_its_own_is_told_by_the_clock(intake):
    assert intake.is_early(frame(7, 300), NOW_NS)
    intake.pair(*fire(intake, 0, 100, NOW_NS), was_early=True)
    intake.shooting.grant()
    assert intake.is_early(frame(8, 340), NOW_NS) and intake.is_early(frame(9, 360), NOW_NS)
    shots = [intake.pair(event, was_early=True).shot for event in fire(intake, 1, 160, NOW_NS + 20 * MS)]
    assert [shot and shot.frame_index for shot in shots] == [None, 1]


def test_a_frame_that_waited_too_long_is_extra(intake):
    assert intake.is_early(frame(7, 300), NOW_NS)
    assert fire(intake, 0, 100, NOW_NS + 151 * MS) == [] and intake.counters["extra"] == 1
