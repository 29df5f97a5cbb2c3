"""The tables of states and faults, and the words made from them."""

from __future__ import annotations

import pytest

from acquire.contract.faults import FAULTS, in_one_line, report
from acquire.contract.scan_data.checksums import scan_digest
from acquire.contract.states import (
    SIGNS,
    TRANSITIONS,
    IllegalTransitionError,
    Outcome,
    State,
    outcome_words,
    sign_of,
    transition,
)
from acquire.contract.units import format_bytes, format_duration


def test_a_transition_of_the_table_is_allowed():
    assert transition(State.IDLE, State.ARMED) is State.ARMED
    assert transition(State.SWEEPING, State.SWEEPING) is State.SWEEPING


def test_a_transition_that_the_table_lacks_raises():
    with pytest.raises(IllegalTransitionError, match="idle -> sweeping"):
        transition(State.IDLE, State.SWEEPING)


def test_every_state_can_be_reached_and_left():
    assert set(TRANSITIONS) == set(State)
    reached = set().union(*TRANSITIONS.values())
    assert reached == set(State)
    assert all(TRANSITIONS.values())


def test_every_state_has_a_sign_of_its_own_and_a_state_of_a_newer_daemon_has_one_too():
    assert set(SIGNS) == set(State)
    assert len(set(SIGNS.values())) == len(SIGNS) and all(sign.ascii_glyph.isascii() for sign in SIGNS.values())
    assert sign_of("levitating").glyph == "?"


def test_all_27_faults_say_what_happened_what_is_safe_and_what_to_do():
    assert sorted(FAULTS) == [f"F{number:02d}" for number in range(1, 28)]
    for fault in FAULTS.values():
        assert fault.happened and fault.safe and fault.to_do


def test_a_report_is_one_line_with_its_facts():
    line = in_one_line(report("F03", committed=412, expected=527))
    assert line.startswith("F03") and "412 of 527" in line and "\n" not in line


def test_a_fact_that_is_not_known_stays_visible():
    assert "?" in report("F06").happened


def test_only_a_complete_scan_with_nothing_missing_is_called_saved():
    assert outcome_words(Outcome.COMPLETE, 527, 527).startswith("SAVED")
    assert outcome_words(Outcome.COMPLETE, 526, 527) == "complete: 526 of 527 frames are safe"
    assert outcome_words(Outcome.STOPPED, 412, 527) == "stopped: 412 of 527 frames are safe"


def test_the_digest_counts_missing_frames_as_zero():
    import hashlib

    import numpy as np

    wanted = hashlib.sha256(bytes([1, 0, 0, 0, 0, 0, 0, 0, 2, 1, 0, 0])).hexdigest()
    assert scan_digest(np.array([1, 0, 258], np.uint32)) == wanted


def test_durations_and_sizes_are_written_for_people():
    assert format_duration(3725.2) == "1:02:06"
    assert format_duration(None) == format_duration(float("inf")) == "-:--:--"
    assert format_bytes(1_240_000_000) == "1.2 GB" and format_bytes(12) == "12 B"
