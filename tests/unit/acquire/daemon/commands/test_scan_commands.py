"""An estimate of a scan, and what refuses one."""

from __future__ import annotations

import pytest

from acquire.contract.errors import CommandRefusedError


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
