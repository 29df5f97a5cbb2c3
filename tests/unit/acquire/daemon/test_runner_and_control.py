"""What the rig does beside no sweep: pictures for whoever looks, one holder of control, and an estimate of a scan."""

from __future__ import annotations

import numpy as np
import pytest

from acquire.contract.errors import CommandRefusedError
from acquire.daemon.commands.control import Control
from acquire.stages.protocol import Alarm

# ---- preview ----


def test_a_preview_shows_pictures_while_it_is_on_and_ends_in_idle(start_rig):
    rig = start_rig()
    watcher = rig.watch()
    rig.ask("preview", on=True, rate_hz=30)
    assert rig.status()["state"] == "preview" and rig.status()["activity"] == "preview"
    picture, pixels = rig.picture(watcher)
    assert picture.shape == [48, 64, 3] and picture.source_shape == [48, 64] and picture.frame_index == -1
    assert len(pixels) == 48 * 64 * 3 and picture.exposure_ms == 30
    rig.ask("preview", on=False)
    assert rig.status()["state"] == "idle" and rig.status()["activity"] == ""


def test_a_preview_shows_what_the_camera_sees_where_the_stage_is(start_rig):
    rig = start_rig()
    watcher = rig.watch()
    rig.ask("lamp", on=True)
    rig.ask("goto", position_steps=1578)
    rig.until(lambda s: s["state"] == "idle", "the stage rests")
    rig.ask("preview", on=True, rate_hz=30)
    picture, pixels = rig.picture(watcher)
    assert picture.position_steps == 1578 and picture.high > 100
    assert np.frombuffer(pixels, np.uint8).max() > 100
    assert 0 <= picture.low <= picture.high and 0 <= picture.full_scale_share <= 1


def test_nobody_looks_no_picture_is_taken(start_rig):
    rig = start_rig()
    rig.ask("preview", on=True, rate_hz=30)
    taken = rig.frames()
    for _ in range(20):
        rig.status()
    assert rig.frames() == taken
    rig.picture(rig.watch())


def test_the_stage_moves_while_the_preview_goes_on_and_comes_back_to_it(start_rig):
    rig = start_rig(simulation__time_scale=0.2)
    watcher = rig.watch()
    rig.ask("preview", on=True, rate_hz=30)
    rig.ask("goto", position_steps=4000)
    assert rig.status()["state"] == "moving"
    seen = {rig.picture(watcher)[0].position_steps for _ in range(6)}
    assert len(seen) > 1, "the pictures do not follow the stage"
    assert rig.until(lambda s: s["state"] != "moving", "the stage rests")["state"] == "preview"
    rig.ask("home")
    assert rig.until(lambda s: s["state"] != "homing", "the stage is home")["state"] == "preview"


def test_a_scan_may_start_from_a_preview_which_then_ends(start_rig):
    rig = start_rig()
    rig.watch()
    rig.ask("preview", on=True)
    rig.ask("scan", purpose="raw")
    status = rig.until(lambda s: s["state"] == "idle", "the scan ends: nobody writes it")
    assert status["activity"] == "" and status["faults"][0]["code"] == "F05"


def test_the_previews_last_picture_is_not_taken_for_one_of_the_sweep(start_rig, monkeypatch):
    rig = start_rig(simulation__time_scale=5.0, camera__frame_timeout_ms=20000.0, limits__writer_start_s=20.0)
    asked_for = []
    snap = rig.daemon.rig.camera.snap
    monkeypatch.setattr(rig.daemon.rig.camera, "snap", lambda: (asked_for.append("a picture"), snap()))
    rig.watch()
    rig.ask("preview", on=True, rate_hz=30)
    rig.until_true(lambda: len(asked_for) > rig.frames(), "a picture is on its way")
    rig.ask("scan", purpose="raw")
    rig.until_true(lambda: len(asked_for) == rig.frames(), "it has come")
    assert rig.status()["counters"]["received"] == rig.status()["counters"]["check_frames"] == 0


def test_a_preview_during_a_sweep_is_refused_in_words(start_rig):
    rig = start_rig(limits__writer_start_s=20.0)
    rig.ask("scan", purpose="raw")
    with pytest.raises(CommandRefusedError, match="a scan is running, and its pictures are shown already"):
        rig.ask("preview", on=True)
    rig.ask("stop")


# ---- settings and limits ----


def test_settings_change_while_previewing_and_limits_are_named(start_rig):
    rig = start_rig()
    assert rig.status()["camera_limits"]["exposure_ms"] == [0.01, 75.0]
    rig.ask("preview", on=True)
    assert rig.ask("camera", gain=12)["gain"] == 12
    with pytest.raises(CommandRefusedError, match=r"exposure_ms 90 is outside the camera's 0\.01\.\.75 ms"):
        rig.ask("camera", exposure_ms=90)
    assert rig.status()["camera"] == {"exposure_ms": 30.0, "gain": 12.0, "brightness_percent": 0.0}


def test_a_jog_is_clipped_at_the_soft_limit_and_a_goto_beyond_it_refused_by_name(start_rig):
    rig = start_rig()
    assert rig.ask("jog", steps=10_000) == {
        "target_steps": 4500, "clipped": "the soft limit stage.travel_max_steps = 4500"
    }  # fmt: skip
    rig.until(lambda s: s["state"] == "idle", "the stage rests")
    with pytest.raises(CommandRefusedError, match="at the soft limit stage.travel_max_steps = 4500 already"):
        rig.ask("jog", steps=1)
    with pytest.raises(CommandRefusedError, match="beyond the soft limit stage.travel_min_steps = 0"):
        rig.ask("goto", position_steps=-1)


def test_the_lamps_warm_up_counts_down(start_rig):
    rig = start_rig(lamp__warm_up_s=3000.0)
    assert rig.status()["lamp_warm_s"] == 0
    rig.ask("lamp", on=True)
    first = rig.status()["lamp_warm_s"]
    assert 0 < first <= 30
    assert rig.until(lambda s: s["lamp_warm_s"] < first, "it counts")["lamp_warm_s"] > 0


# ---- control ----


def test_who_holds_control_is_shown_and_others_are_refused_by_name_but_may_stop(start_rig):
    rig = start_rig()
    rig.ask_as("anna on pts/3", "control", action="take")
    assert rig.status()["control"] == "anna on pts/3"
    for who in ("ben on pts/4", ""):
        with pytest.raises(CommandRefusedError, match="anna on pts/3 holds control: take it with 'control take'"):
            rig.ask_as(who, "jog", steps=5)
    rig.ask("stop")
    rig.ask("estimate", purpose="raw")
    assert rig.ask_as("anna on pts/3", "jog", steps=5)["target_steps"] == 5


def test_control_is_taken_over_given_back_and_then_anybody_may_act(start_rig):
    rig = start_rig()
    rig.ask_as("anna", "control", action="take")
    assert rig.ask_as("ben", "control", action="take") == {"holder": "ben"}
    with pytest.raises(CommandRefusedError, match="ben holds control"):
        rig.ask_as("anna", "control", action="renew")
    rig.ask_as("ben", "control", action="release")
    assert rig.ask("jog", steps=5)["target_steps"] == 5


def test_a_client_without_a_name_cannot_hold_control(start_rig):
    with pytest.raises(CommandRefusedError, match="at a terminal only"):
        start_rig().ask("control", action="take")


def test_control_lapses_ten_seconds_after_its_holders_last_word():
    control = Control()
    second = 1_000_000_000
    control.change("take", "anna", 0)
    control.hear("jog", "anna", 5 * second)
    assert control.holder(14 * second) == "anna" and control.holder(15 * second) == ""
    control.hear("jog", "ben", 15 * second)


# ---- a rig in fault ----


def test_a_rig_in_fault_moves_again_only_after_the_fault_was_acknowledged(start_rig):
    rig = start_rig()
    rig.ask("preview", on=True)
    rig.emit(Alarm("F23", "the limit switch was hit", 12, position_trusted=True))
    status = rig.until(lambda s: s["state"] == "fault", "the alarm is shown")
    assert status["faults"][0]["code"] == "F23" and status["activity"] == ""
    for command, args in (("home", {}), ("preview", {"on": True}), ("expose", {})):
        with pytest.raises(CommandRefusedError, match="the rig is in fault; remove its cause and acknowledge it"):
            rig.ask(command, **args)
    rig.ask("acknowledge")
    rig.ask("home")
    assert rig.until(lambda s: s["state"] == "idle", "the stage is home")["faults"][0]["acknowledged"]


# ---- estimate ----


def test_an_estimate_says_what_a_scan_takes_and_makes_nothing(start_rig, tmp_path):
    rig = start_rig()
    found = rig.ask("estimate", first_steps=0, last_steps=1200, steps_per_frame=12)
    assert found["expected"] == 101 and found["seconds"] > 0 and found["warnings"] == []
    assert found["bytes"] >= 101 * 64 * 48 * 3 and found["free_bytes"] > found["bytes"]
    assert not (tmp_path / "scans").exists() and rig.status()["state"] == "idle"


def test_an_estimate_refuses_in_the_words_of_the_scan(start_rig):
    rig = start_rig()
    words = []
    for command in ("estimate", "scan"):
        with pytest.raises(CommandRefusedError, match="outside the stage's travel") as refused:
            rig.ask(command, last_steps=9000)
        words.append(str(refused.value).removeprefix(f"{command} was refused"))
    assert words[0] == words[1]
