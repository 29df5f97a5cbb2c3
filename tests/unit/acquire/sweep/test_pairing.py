"""Pairing finds the trigger of each frame and never guesses."""

from __future__ import annotations

import numpy as np
import pytest

from acquire.cameras.protocol import CameraFrame
from acquire.sweep.pairing import Match, Pairing, Shot, Tolerances

MS = 1_000_000


def fire(pairing: Pairing, frame_index: int, at_ms: int, attempt: int = 0) -> None:
    shot = Shot(
        frame_index=frame_index,
        attempt=attempt,
        trigger_id=100 + frame_index,
        position_steps=3 * frame_index,
        position_um=9.525 * frame_index,
        trigger_cycles=0,
        at_mono_ns=at_ms * MS,
        deadline_ns=(at_ms + 100) * MS,
        fired_ns=at_ms * MS,
    )
    pairing.triggered(shot)


def arrive(pairing: Pairing, camera_frame_id: int, exposure_start_ns: int, camera_ns: int = 0) -> Match:
    return pairing.match(CameraFrame(np.zeros((1, 1), np.uint8), camera_frame_id, exposure_start_ns, camera_ns))


def armed() -> Pairing:
    pairing = Pairing()
    pairing.arm(1000 * MS)
    return pairing


def test_a_frame_belongs_to_the_trigger_before_it():
    pairing = armed()
    fire(pairing, 0, 1010)
    match = arrive(pairing, 7, 1010 * MS)
    assert match.shot is not None and match.shot.frame_index == 0
    assert match.lost == ()


def test_a_frame_that_nobody_triggered_is_dropped():
    pairing = armed()
    assert arrive(pairing, 7, 1010 * MS).shot is None


def test_a_jump_of_the_ids_names_the_trigger_whose_frame_was_lost():
    pairing = armed()
    fire(pairing, 0, 1010)
    arrive(pairing, 7, 1010 * MS)
    fire(pairing, 1, 1020)
    fire(pairing, 2, 1030)
    match = arrive(pairing, 9, 1030 * MS)
    assert [shot.frame_index for shot in match.lost] == [1]
    assert match.shot is not None and match.shot.frame_index == 2


def test_a_repeated_frame_is_not_taken_twice():
    pairing = armed()
    fire(pairing, 0, 1010)
    arrive(pairing, 7, 1010 * MS)
    fire(pairing, 1, 1020)
    assert arrive(pairing, 7, 1020 * MS).shot is None
    match = arrive(pairing, 8, 1020 * MS)
    assert match.shot is not None and match.shot.frame_index == 1


def test_an_exposure_from_before_the_trigger_is_not_its_frame():
    pairing = armed()
    fire(pairing, 0, 1050)
    assert arrive(pairing, 7, 1020 * MS).shot is None


def test_an_exposure_from_before_the_arming_is_stale():
    pairing = armed()
    fire(pairing, 0, 1001)
    assert arrive(pairing, 7, 900 * MS).shot is None
    assert len(pairing.pending) == 1


def test_an_extra_frame_between_two_triggers_does_not_shift_the_pairs():
    pairing = armed()
    fire(pairing, 0, 1010)
    arrive(pairing, 7, 1010 * MS)
    assert arrive(pairing, 8, 1015 * MS).shot is None
    fire(pairing, 1, 1020)
    match = arrive(pairing, 9, 1020 * MS)
    assert match.shot is not None and match.shot.frame_index == 1


def test_a_trigger_without_a_frame_is_lost_after_its_deadline():
    pairing = armed()
    fire(pairing, 0, 1010)
    assert pairing.overdue(1100 * MS) == ()
    assert [shot.frame_index for shot in pairing.overdue(1110 * MS)] == [0]
    assert not pairing.pending


def test_giving_up_returns_all_that_was_awaited():
    pairing = armed()
    fire(pairing, 4, 1010)
    assert [shot.frame_index for shot in pairing.drop_all()] == [4]


# ---- on the fly several triggers are under way: ids alone cannot tell of one that the camera never saw ----

FLY = Tolerances(late_ns=15 * MS, early_ns=5 * MS, drift_ns=5 * MS)
"""A trigger every 20 ms."""
CAMERA_AHEAD_NS = 77_000 * MS


def on_the_fly() -> Pairing:
    pairing = Pairing()
    pairing.arm(1000 * MS, FLY)
    return pairing


@pytest.mark.parametrize("unseen", [0, 1, 2])
def test_a_trigger_that_the_camera_never_saw_does_not_move_the_frames_behind_it_up(unseen):
    pairing, pairs, lost = on_the_fly(), [], []
    for k in range(5):
        fire(pairing, k, 1010 + 20 * k)
    for number, k in enumerate(k for k in range(5) if k != unseen):
        match = arrive(pairing, 7 + number, (1010 + 20 * k) * MS)
        pairs.append((k, match.shot and match.shot.frame_index))
        lost += [shot.frame_index for shot in match.lost]
    assert pairs == [(k, k) for k in range(5) if k != unseen] and lost == [unseen]


def test_the_last_trigger_that_the_camera_never_saw_is_lost_by_its_deadline():
    pairing = on_the_fly()
    fire(pairing, 0, 1010)
    fire(pairing, 1, 1030)
    assert arrive(pairing, 7, 1010 * MS).shot is not None
    assert [shot.frame_index for shot in pairing.overdue(1130 * MS)] == [1]


def test_the_cameras_own_clock_tells_of_a_trigger_that_it_never_saw():
    pairing = on_the_fly()
    fire(pairing, 0, 1010)
    first = arrive(pairing, 7, 0, CAMERA_AHEAD_NS + 1010 * MS)
    assert first.shot is not None and pairing.has_times
    fire(pairing, 1, 1030)
    fire(pairing, 2, 1050)
    match = arrive(pairing, 8, 0, CAMERA_AHEAD_NS + 1051 * MS)
    assert [shot.frame_index for shot in match.lost] == [1]
    assert match.shot is not None and match.shot.frame_index == 2


def test_a_frame_that_comes_too_late_by_the_cameras_clock_is_not_that_of_the_next_trigger():
    pairing = on_the_fly()
    fire(pairing, 0, 1010)
    arrive(pairing, 7, 0, CAMERA_AHEAD_NS + 1010 * MS)
    fire(pairing, 1, 1030)
    pairing.overdue(1130 * MS)
    fire(pairing, 2, 1050)
    assert arrive(pairing, 8, 0, CAMERA_AHEAD_NS + 1030 * MS).shot is None
    match = arrive(pairing, 9, 0, CAMERA_AHEAD_NS + 1050 * MS)
    assert match.shot is not None and match.shot.frame_index == 2


def test_a_camera_without_any_clock_leaves_the_pairing_unable_to_tell_and_each_arming_forgets_the_cameras_clock():
    pairing = on_the_fly()
    fire(pairing, 0, 1010)
    arrive(pairing, 7, 0)
    assert not pairing.has_times
    fire(pairing, 1, 1030)
    arrive(pairing, 8, 0, CAMERA_AHEAD_NS)
    assert pairing.has_times
    pairing.arm(2000 * MS)
    assert not pairing.has_times
