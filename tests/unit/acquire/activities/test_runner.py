"""The preview, and a rig in fault, while no scan runs."""

from __future__ import annotations

import numpy as np
import pytest

from acquire.contract.errors import CommandRefusedError
from acquire.stages.protocol import Alarm


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


def test_without_subscribers_no_picture_is_taken(start_rig):
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
    assert status["activity"] == ""
    assert "F05" in {fault["code"] for fault in status["faults"]}, "beside F02, where the machine is busy"


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
