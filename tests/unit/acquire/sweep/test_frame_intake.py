"""Frames that overtake the report of their trigger: kept for it where a clock will tell, and never guessed."""

from __future__ import annotations

import numpy as np
import pytest

from acquire.cameras.protocol import CameraFrame
from acquire.stages.protocol import Triggered
from acquire.sweep.credit_window import CreditWindow
from acquire.sweep.frame_intake import FrameIntake
from tests.unit.sweep_bench import MS, settings

NOW_NS = 5000 * MS


def frame(camera_frame_id: int, camera_ms: int) -> CameraFrame:
    return CameraFrame(np.ones((4, 5), np.uint8), camera_frame_id, 0, camera_ms * MS)


@pytest.fixture
def intake() -> FrameIntake:
    made = FrameIntake(settings(), CreditWindow(100))
    made.arm(NOW_NS)
    return made


def take(intake: FrameIntake, shot_index: int, fired_ms: int, now_ns: int = NOW_NS + 20 * MS) -> list[int | None]:
    """A trigger, and the frames of the sweep that are taken of those that waited for it."""
    event = Triggered(shot_index, shot_index, 30 + 3 * shot_index, fired_ns=fired_ms * MS)
    intake.triggered(event, shot_index, 0, now_ns)
    shots = [intake.pair(waited, was_early=True).shot for waited in intake.early(now_ns)]
    return [shot and shot.frame_index for shot in shots]


def begin_again(intake: FrameIntake, now_ns: int = NOW_NS) -> None:
    intake.arm(now_ns)


def test_the_first_frame_before_the_report_of_its_trigger_proves_nothing_and_its_second_attempt_is_taken(intake):
    assert intake.keep_early(frame(7, 300), NOW_NS + MS)
    assert take(intake, 0, 100) == [None] and intake.counters["doubtful"] == 1
    begin_again(intake, NOW_NS + 30 * MS)
    assert intake.keep_early(frame(8, 700), NOW_NS + 31 * MS)
    assert take(intake, 0, 501, NOW_NS + 50 * MS) == [0]


def test_a_stray_frame_before_the_first_trigger_is_not_taken_for_its_own(intake):
    assert intake.keep_early(frame(7, 250), NOW_NS + MS)
    assert take(intake, 0, 100) == [None]
    begin_again(intake, NOW_NS + 30 * MS)
    assert intake.keep_early(frame(8, 700), NOW_NS + 31 * MS)
    assert take(intake, 0, 500, NOW_NS + 50 * MS) == [None], "it differs from what the stray one made likely"


def proven(intake: FrameIntake) -> None:
    """The first frame came after its trigger's report: the clocks differ by 200 ms."""
    assert take(intake, 0, 100) == []
    assert intake.pair(frame(7, 300)).shot is not None


def test_of_two_frames_before_a_later_trigger_its_own_is_told_by_the_clock(intake):
    proven(intake)
    assert intake.keep_early(frame(8, 340), NOW_NS + MS) and intake.keep_early(frame(9, 360), NOW_NS + MS)
    assert take(intake, 1, 160) == [None, 1]
    assert intake.counters["extra"] == 1


def test_a_frame_that_is_ahead_by_two_triggers_waits_for_the_second(intake):
    proven(intake)
    assert intake.keep_early(frame(8, 360), NOW_NS + MS) and intake.keep_early(frame(9, 420), NOW_NS + MS)
    assert take(intake, 1, 160) == [1]
    assert take(intake, 2, 220) == [2] and intake.counters["extra"] == 0


def test_a_frame_from_before_the_camera_was_armed_is_extra(intake):
    assert intake.keep_early(frame(7, 300), NOW_NS + MS)
    begin_again(intake, NOW_NS + 2 * MS)
    assert take(intake, 0, 100) == [] and intake.counters["extra"] == 1


def test_a_frame_that_waited_too_long_is_extra_without_any_trigger(intake):
    assert intake.keep_early(frame(7, 300), NOW_NS)
    intake.overdue(NOW_NS + 151 * MS)
    assert intake.counters["extra"] == 1
