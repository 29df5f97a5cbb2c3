"""One client at most holds control; the others may watch, estimate and stop."""

from __future__ import annotations

import pytest

from acquire.contract.errors import CommandRefusedError
from acquire.daemon.commands.control import Control


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
