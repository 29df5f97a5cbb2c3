"""Jog presses become bounded moves; STOP's watch; what people type; the operator's keys."""

from __future__ import annotations

import msgspec
import pytest

from acquire.contract.errors import ConfigError
from acquire.contract.messaging.messages import Proposal
from acquire.contract.states import HoldReason, State
from tests.fakes.fake_daemon import IDLE, SWEEPING
from tui.console.keys import load_keymap
from tui.console.state.estimate import Estimate
from tui.console.state.jog import JogGate, clip, next_size
from tui.console.state.next_scan import NextScan
from tui.console.state.scan_forms import parse_plan, parse_words
from tui.console.state.scan_rules import why_not
from tui.console.state.stop_state import StopState
from tui.text.positions import parse_position

TRAVEL = (0, 4500)


def replace(status, **changes):
    return msgspec.structs.replace(status, **changes)


def test_one_press_is_one_move():
    gate = JogGate()
    assert gate.press(3, 0.0) == 3


def test_repeats_while_a_move_is_in_flight_leave_at_most_one_waiting():
    gate = JogGate()
    assert gate.press(3, 0.0) == 3
    for number in range(30):
        assert gate.press(3, 0.01 * number) == 0
    gate.answered(ok=True, at_ns=100)
    assert gate.take_status(moving=True, sent_ns=150, now_s=0.4) == 0
    assert gate.take_status(moving=False, sent_ns=200, now_s=0.5) == 3
    gate.answered(ok=True, at_ns=300)
    assert gate.take_status(moving=False, sent_ns=400, now_s=0.9) == 0


def test_a_state_that_was_said_before_the_move_was_taken_does_not_end_it():
    gate = JogGate()
    gate.press(3, 0.0)
    gate.press(3, 0.1)
    gate.answered(ok=True, at_ns=100)
    assert gate.take_status(moving=False, sent_ns=99, now_s=0.2) == 0


def test_a_refused_move_and_a_stop_leave_nothing_waiting():
    gate = JogGate()
    gate.press(3, 0.0)
    gate.press(3, 0.1)
    gate.answered(ok=False, at_ns=100)
    assert gate.take_status(moving=False, sent_ns=200, now_s=0.3) == 0
    assert gate.press(3, 0.4) == 3
    gate.press(3, 0.5)
    gate.forget()
    gate.answered(ok=True, at_ns=500)
    assert gate.take_status(moving=False, sent_ns=600, now_s=0.9) == 0


def test_a_move_whose_end_was_never_heard_of_does_not_block_for_ever():
    gate = JogGate()
    gate.press(3, 0.0)
    assert gate.press(3, 60.0) == 3


def test_a_held_key_renews_the_lease_with_fresh_presses_only_and_not_too_often():
    gate = JogGate()
    assert [gate.hold(0.03 * number) for number in range(6)] == [True, False, False, True, False, False]


@pytest.mark.parametrize(
    ("position", "steps", "left", "limit"),
    [
        (100, 30, 30, ""),
        (4490, 30, 10, "4500"),
        (10, -30, -10, "lower limit"),
        (4600, 30, 0, "4600"),
        (4600, -30, -30, ""),
    ],
)
def test_a_move_is_clipped_to_the_travel_and_says_the_limit(position, steps, left, limit):
    found = clip(position, steps, TRAVEL, 3.175)
    assert found.steps == left and limit in found.words and bool(found.words) == bool(limit)


def test_the_fine_step_goes_through_its_sizes_and_stays_at_the_ends():
    assert [next_size(3, 1), next_size(3, -1), next_size(1, -1), next_size(300, 1)] == [10, 1, 1, 300]


# ---- STOP ----


def test_stop_is_sent_once_whether_the_key_or_its_answer_is_heard_first():
    watch = StopState()
    watch.sent_early()
    assert not watch.pressed()
    watch.answered(ok=True, at_mono_ns=10)
    assert watch.take_status(replace(IDLE, sent_mono_ns=11)).startswith("stopped at")
    watch.sent_early()
    watch.answered(ok=True, at_mono_ns=20)
    assert not watch.pressed() and watch.words == "STOP sent"
    assert watch.take_status(replace(IDLE, sent_mono_ns=21)).startswith("stopped at") and not watch.words


def test_a_stop_without_the_early_thread_is_sent_by_the_loop():
    assert StopState().pressed()


# ---- what people type ----


@pytest.mark.parametrize(("text", "steps"), [("1578", 1578), (" -3 ", -3), ("5010.15um", 1578), ("5.01 mm", 1578)])
def test_positions_are_read_in_microsteps_um_and_mm(text, steps):
    assert parse_position(text, 3.175) == steps


@pytest.mark.parametrize("text", ["", "abc", "1.5", "1e3", "5 km", "nan"])
def test_what_is_no_position_is_refused_in_words(text):
    with pytest.raises(ValueError, match=r"position|whole"):
        parse_position(text, 3.175)


PLAN = {"first": "10", "last": "400", "steps": "5", "settle": "2.5", "mode": "fly"}


def test_a_plan_is_read():
    plan = parse_plan(PLAN, NextScan(), TRAVEL)
    assert plan.plan_args() == {
        "first_steps": 10, "last_steps": 400, "steps_per_frame": 5, "mode": "fly", "settle_ms": 2.5
    }  # fmt: skip
    assert plan.frames == 79


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"last": "9000"}, "travel"),
        ({"steps": "0"}, "outside"),
        ({"mode": "hop"}, "neither"),
        ({"settle": "x"}, "number"),
    ],
)
def test_a_plan_that_cannot_be_is_refused_by_name(wrong, words):
    with pytest.raises(ValueError, match=words):
        parse_plan(PLAN | wrong, NextScan(), TRAVEL)


def test_words_about_a_scan_reach_its_arguments_and_empty_ones_do_not():
    typed = {"name": "ear-2", "specimen": "left ear", "operator": "", "notes": "dry", "tags": "a, b c"}
    args = parse_words(typed, NextScan()).scan_args()
    assert args["specimen"] == "left ear" and args["tags"] == ["a", "b", "c"] and "operator" not in args
    with pytest.raises(ValueError, match="not a name"):
        parse_words(typed | {"name": "../x"}, NextScan())


def test_a_proposal_is_taken_over_into_the_plan():
    found = Proposal(
        first_steps=120, last_steps=900, exposure_ms=20, frames=261, seconds=20, nbytes=1, free_bytes=2
    )  # fmt: skip
    assert NextScan().with_proposal(found).plan_args()["first_steps"] == 120


def test_an_answer_without_numbers_leaves_the_estimate_unknown_and_a_refusal_is_kept():
    assert not Estimate.of_answer(ok=True, detail="", result={}).known
    assert Estimate.of_answer(ok=False, detail="the disk is full", result={}).refused == "the disk is full"
    full = {"expected": 5, "seconds": 3.0, "bytes": 10, "free_bytes": 20, "warnings": ["w"]}
    assert (
        Estimate.of_answer(ok=True, detail="", result=full).words(NextScan()) == "5 frames  0:00:03  10 B of 20 B free"
    )


# ---- when ----


@pytest.mark.parametrize(
    ("action", "status", "words"),
    [
        ("start", SWEEPING, "a scan is running; stop it first"),
        ("start", replace(IDLE, position_trusted=False), "not trusted"),
        ("start", IDLE, ""),
        ("jog", replace(IDLE, state=State.MOVING), "the rig is moving"),
        ("hold", replace(IDLE, state=State.MOVING, activity="jog"), ""),
        ("adjust", replace(IDLE, state=State.PREVIEW), ""),
        ("adjust", SWEEPING, "a scan is running"),
        ("resume", replace(SWEEPING, state=State.HOLDING, hold_reason=HoldReason.NO_CREDIT), "by itself"),
        ("home", replace(IDLE, state=State.PREVIEW, activity="prescan"), "prescan is running"),
        ("use_proposal", IDLE, "no proposal"),
        ("pause", None, "not known"),
        ("size", None, ""),
    ],
)
def test_each_action_says_why_it_cannot_be_done_now(action, status, words):
    found = why_not(action, status)
    assert words in found and bool(words) == bool(found)


# ---- the operator's keys ----


def test_the_operators_keys_are_read_and_no_file_means_none(tmp_path):
    path = tmp_path / "keys.toml"
    assert load_keymap(path, lambda: {"scan.start"}) == {}
    path.write_text('"scan.start" = "S"\n')
    assert load_keymap(path, lambda: {"scan.start"}) == {"scan.start": "S"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('"scan.strat" = "S"', "did you mean 'scan.start'"),
        ('"scan.start" = "space"', "same everywhere"),
        ("=", "keys.toml"),
    ],
)
def test_keys_that_cannot_be_are_refused_by_name(tmp_path, text, words):
    path = tmp_path / "keys.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        load_keymap(path, lambda: {"scan.start", "scan.stop"})
