"""Settings and moves within their limits."""

from __future__ import annotations

import pytest

from acquire.contract.errors import CommandRefusedError


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
