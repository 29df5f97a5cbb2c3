"""Exposure search, pre-scan and motion under a lease: at a daemon with a simulated rig, and their pure parts."""

from __future__ import annotations

import numpy as np
import pytest

from acquire.activities.exposure_search import advise
from acquire.activities.jog_hold import LEASE_MS, MOST_STEPS
from acquire.activities.prescan import prescan_positions
from acquire.activities.prescan_analysis import PrescanPictures, find_bounds, propose_exposure
from acquire.contract.errors import CommandRefusedError
from acquire.contract.units import NS_PER_MS
from tests.unit.rig_in_process import AdjustableClock, RigInProcess

OVER_THE_SPECIMEN = 700
BY_HAND = {"sweep__max_rate_hz": 15.0}


def light_on(rig: RigInProcess) -> None:
    rig.ask("lamp", on=True)
    rig.ask("goto", position_steps=OVER_THE_SPECIMEN)
    rig.until(lambda s: s["state"] == "idle", "the stage rests")


def ended(rig: RigInProcess) -> dict:
    return rig.until(lambda s: not s["activity"] and s["state"] == "idle", "the activity ends")


# ---- exposure ----


@pytest.mark.parametrize("exposure_ms", [0.1, 60.0])
def test_the_exposure_is_found_from_far_below_and_far_above_and_told(start_rig, exposure_ms):
    rig = start_rig(**BY_HAND, camera__exposure_ms=exposure_ms)
    light_on(rig)
    watcher = rig.watch()
    assert rig.ask("expose")["longest_ms"] == 60.0
    status = ended(rig)
    assert status["message"].startswith("exposure: ") and status["message"].endswith("locked")
    assert status["counters"]["activities_done"] == 1
    rig.ask("preview", on=True, rate_hz=30)
    newest = [rig.picture(watcher)[0] for _ in range(8)][-1]
    assert newest.exposure_ms == status["camera"]["exposure_ms"]
    assert 0.8 * 255 <= newest.high <= 0.9 * 255


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"camera__gain": 0.0, "sweep__max_rate_hz": 500.0}, "too dark"),
        ({"camera__brightness_percent": 100.0}, "satur"),
    ],
)
def test_without_a_good_exposure_it_fails_in_words_and_stays_as_it_was(start_rig, settings, words):
    rig = start_rig(**BY_HAND | settings)
    light_on(rig)
    rig.ask("expose")
    status = ended(rig)
    assert words in status["message"] and "30 ms as before" in status["message"]
    assert status["camera"]["exposure_ms"] == 30 and status["counters"]["activities_failed"] == 1


def test_the_exposure_is_not_searched_in_the_dark_nor_while_the_lamp_warms_up(start_rig):
    rig = start_rig(lamp__warm_up_s=3000.0)
    with pytest.raises(CommandRefusedError, match="the lamp is off; switch it on and bring the light over"):
        rig.ask("expose")
    rig.ask("lamp", on=True)
    with pytest.raises(CommandRefusedError, match=r"the lamp is warm in \d+ s"):
        rig.ask("expose")


def test_a_camera_that_gives_no_picture_ends_the_search_in_words(start_rig):
    lost = ",".join(f"lose:{n}" for n in range(40))
    rig = start_rig(**BY_HAND, simulation__faults=lost, camera__frame_timeout_ms=50.0)
    light_on(rig)
    rig.ask("expose")
    assert "no usable picture came" in ended(rig)["message"]


@pytest.mark.parametrize("damage", ["shape", "type"])
def test_a_damaged_picture_is_counted_and_not_measured(start_rig, damage):
    rig = start_rig(**BY_HAND, simulation__faults=f"{damage}:1")
    rig.ask("prescan", first_steps=0, last_steps=300, every_steps=100)
    status = ended(rig)
    assert "no usable picture came at position 2 of 4" in status["message"]
    assert status["counters"]["pictures_damaged"] == 1 and status["proposal"] is None


def test_a_camera_that_fails_while_the_exposure_is_searched_ends_it_and_not_the_daemon(start_rig, monkeypatch):
    rig = start_rig(**BY_HAND, camera__exposure_ms=1.0)
    light_on(rig)

    def refuse(_settings):
        raise CommandRefusedError("the camera is unplugged")

    real = rig.daemon.rig.camera.snap
    monkeypatch.setattr(
        rig.daemon.rig.camera, "snap", lambda: (real(), setattr(rig.daemon.rig.camera, "configure", refuse))
    )
    rig.ask("expose")
    status = ended(rig)
    assert "the camera is unplugged; and it is not as it was before" in status["message"]
    assert status["counters"]["activities_failed"] == 1


@pytest.mark.parametrize(
    ("exposure_ms", "high", "wanted_ms"),
    [(10, 0.425, 20), (10, 1.0, 3.5), (10, 0.01, 60), (1, 0.01, 8), (50, 0.6, 60), (0.02, 1.0, 0.01)],
)
def test_the_next_exposure_follows_from_the_picture_within_the_bounds(exposure_ms, high, wanted_ms):
    advice = advise(exposure_ms, high, 0.0, (0.01, 60))
    assert not advice.done and advice.exposure_ms == pytest.approx(wanted_ms)


def test_the_black_level_is_not_taken_for_light():
    assert advise(10, 0.425, 0.25, (0.01, 60)).exposure_ms == pytest.approx(10 * 0.6 / 0.175)


# ---- pre-scan ----


def test_a_prescan_proposes_bounds_just_outside_the_light_on_the_specimen(start_rig):
    rig = start_rig(**BY_HAND, simulation__object="dome")
    assert rig.ask("prescan", first_steps=0, last_steps=1578, every_steps=60)["looks"] == 28
    assert rig.status()["activity"] == "prescan"
    with pytest.raises(CommandRefusedError, match="prescan is running; wait, or stop it"):
        rig.ask("jog", steps=3)
    status = ended(rig)
    found = status["proposal"]
    # the truth of this scene: crossings from 377 to 939
    assert 240 <= found["first_steps"] <= 370 and 945 <= found["last_steps"] <= 1080
    assert found["frames"] > 40 and found["seconds"] > 0 and 0 < found["nbytes"] < found["free_bytes"]
    assert "proposes" in status["message"] and status["lamp_on"]


def test_a_prescan_that_begins_in_the_light_warns(start_rig):
    rig = start_rig(**BY_HAND, simulation__object="dome")
    rig.ask("prescan", first_steps=660, last_steps=840, every_steps=60)
    warnings = " ".join(ended(rig)["proposal"]["warnings"])
    assert "is lit in the first picture, at 660: begin outside" in warnings
    assert "is dark until the last picture, at 840: end later" in warnings


def test_a_prescan_is_stopped_at_once_and_proposes_nothing(start_rig):
    rig = start_rig(simulation__time_scale=1.0)
    rig.ask("prescan")
    rig.until(lambda s: s["activity_share"] > 0, "a look is taken")
    assert rig.ask("stop") == {"stopping": "prescan"}
    status = ended(rig)
    assert status["message"] == "prescan: stopped" and status["proposal"] is None


def test_a_prescan_in_between_pictures_goes_on_in_a_preview_and_leaves_it_on(start_rig):
    rig = start_rig(**BY_HAND, simulation__time_scale=0.3)
    watcher = rig.watch()
    rig.ask("preview", on=True, rate_hz=30)
    rig.ask("prescan", first_steps=0, last_steps=300, every_steps=100)
    places: set[int] = set()
    rig.until_true(lambda: places.add(rig.picture(watcher)[0].position_steps) or len(places) > 1, "pictures are shown")
    assert rig.until(lambda s: s["activity"] == "preview", "the pre-scan ends")["state"] == "preview"


def test_a_prescan_outside_the_travel_is_refused(start_rig):
    rig = start_rig()
    with pytest.raises(CommandRefusedError, match="outside the stage's travel"):
        rig.ask("prescan", last_steps=5000)
    assert not rig.status()["lamp_on"]


def test_looks_reach_both_ends_and_are_bounded_in_number():
    assert prescan_positions(0, 130, 60, 3) == [0, 60, 120, 130]
    assert prescan_positions(120, 0, None, 3) == [120, 60, 0]
    assert len(prescan_positions(0, 1_000_000, None, 1)) <= 200
    with pytest.raises(CommandRefusedError, match="every_steps of 5026 or more"):
        prescan_positions(0, 1_000_000, 7, 1)


def taken(pictures, positions):
    found = PrescanPictures()
    for position, picture in zip(positions, pictures, strict=True):
        found.add(position, picture.astype(np.uint8), picture.max() / 255, float((picture == 255).mean()))
    return found


def test_without_a_specimen_it_says_so_and_proposes_what_was_asked():
    found = find_bounds(taken(np.full((4, 30, 40), 20), [0, 60, 120, 180]), 70, (0, 4500))
    assert (found.first_steps, found.last_steps) == (0, 180) and "is there a specimen" in found.warnings[0]


def test_bounds_of_a_sweep_the_other_way_lie_outside_on_both_sides_and_within_the_travel():
    pictures = np.full((5, 30, 40), 10)
    pictures[2:, :, :20] = 200
    pictures[3:, :, 20:] = 200
    found = find_bounds(taken(pictures, [400, 300, 200, 100, 0]), 70, (150, 4500))
    assert (found.first_steps, found.last_steps, found.warnings) == (400, 150, ())


def test_a_proposed_exposure_brings_the_brightest_to_the_target_or_says_why_not():
    pictures = taken(np.full((2, 10, 10), 102), [0, 1])
    assert propose_exposure(pictures, 10.0, 0.0, (0.01, 60)) == (pytest.approx(21.25), "")
    assert "raise the gain" in propose_exposure(pictures, 10.0, 0.0, (0.01, 15))[1]
    assert "is saturated at 10 ms" in propose_exposure(taken(np.full((2, 9, 9), 255), [0, 1]), 10, 0, (1, 60))[1]


# ---- motion under a lease ----


def test_a_held_key_moves_the_stage_until_it_is_let_go(start_rig):
    rig = start_rig(simulation__time_scale=1.0)
    held = rig.ask("jog_hold", direction=1, rate_steps_per_s=100)
    assert held["target_steps"] == MOST_STEPS and str(MOST_STEPS) in held["limit"] and held["lease_ms"] == 300
    rig.ask("jog_hold", direction=1, rate_steps_per_s=100)
    assert rig.status()["activity"] == "jog" and rig.status()["state"] == "moving"
    status = ended(rig)
    assert 0 < status["position_steps"] < MOST_STEPS, "it did not stop by itself when nobody renewed the lease"


def test_a_hold_goes_no_further_than_its_bound_or_the_soft_limit_and_then_wants_the_key_let_go(start_rig):
    clock = AdjustableClock()
    rig = start_rig(clock=clock)
    clock.freeze()
    rig.ask("jog_hold", direction=1, rate_steps_per_s=100_000)
    status = ended(rig)
    assert status["position_steps"] == MOST_STEPS and "the most of one hold" in status["message"]
    with pytest.raises(CommandRefusedError, match="let the key go, and press it again"):
        rig.ask("jog_hold", direction=1)
    pressed_ns = clock.now_ns()
    clock.thaw()
    rig.ask("goto", position_steps=4400)
    ended(rig)
    rig.until_true(lambda: clock.now_ns() > pressed_ns + LEASE_MS * NS_PER_MS, "the key was let go")
    assert "stage.travel_max_steps" in rig.ask("jog_hold", direction=1, rate_steps_per_s=100_000)["limit"]
    assert ended(rig)["position_steps"] == 4500


def test_the_other_direction_stops_the_stage_first(start_rig):
    rig = start_rig(simulation__time_scale=1.0)
    rig.ask("jog_hold", direction=1, rate_steps_per_s=100)
    with pytest.raises(CommandRefusedError, match="slowing down"):
        rig.ask("jog_hold", direction=-1)
    ended(rig)


def test_key_presses_that_come_late_move_nothing(start_rig):
    rig = start_rig(clock=AdjustableClock(ahead_ns=400 * NS_PER_MS))
    with pytest.raises(CommandRefusedError, match=r"jog_hold came 0\.4 s late and was not done"):
        rig.ask("jog_hold", direction=1)
    assert rig.status()["position_steps"] == 0
