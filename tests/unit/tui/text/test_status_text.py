"""What the screens say."""

from __future__ import annotations

import msgspec
import pytest
from rich.cells import cell_len
from rich.text import Text

from acquire.contract.messaging.messages import FaultReport, Proposal
from acquire.contract.states import SIGNS, HoldReason, Outcome, State
from tests.fakes.fake_daemon import IDLE, PROGRESS, SWEEPING
from tui.console.state.session_log import SessionLog
from tui.text.ascii_signs import to_ascii
from tui.text.sizes import parse_size
from tui.text.sparkline import sparkline
from tui.text.status_text import (
    bar,
    fraction_done,
    newest_fault,
    outcome_line,
    position_words,
    progress_line,
    rate_words,
    scan_name,
    state_words,
    status_lines,
)
from tui.text.width import shorten

ENDED = msgspec.structs.replace(SWEEPING, state=State.IDLE, outcome=Outcome.COMPLETE, committed=527, durable=527)


def replace(status, **changes):
    return msgspec.structs.replace(status, **changes)


def test_saved_is_said_of_a_complete_scan_that_lacks_nothing():
    assert outcome_line(ENDED) == "SAVED: 527 of 527 frames are safe"


@pytest.mark.parametrize(
    "changes",
    [
        {"missing": 1},
        {"committed": 526},
        {"outcome": Outcome.STOPPED},
        {"state": State.FINISHING},
        {"outcome": Outcome.RUNNING},
        {"outcome": ""},
    ],
)
def test_saved_is_not_said_of_anything_less(changes):
    assert "SAVED" not in outcome_line(replace(ENDED, **changes))


def test_a_stopped_scan_says_how_many_frames_are_safe():
    status = replace(ENDED, outcome=Outcome.STOPPED, committed=412, missing=115)
    assert outcome_line(status) == "stopped: 412 of 527 frames are safe"


def test_a_held_sweep_names_its_reason():
    status = replace(SWEEPING, state=State.HOLDING, hold_reason=HoldReason.NO_CREDIT)
    assert state_words(status) == "HOLDING (no credit)"


def test_an_untrusted_position_is_called_that():
    assert "NOT TRUSTED" in position_words(replace(IDLE, position_trusted=False))


def test_remaining_time_is_not_guessed_while_the_sweep_holds():
    assert "-:--:--" in rate_words(replace(SWEEPING, state=State.HOLDING))


def test_remaining_time_is_hours_minutes_seconds():
    assert "0:00:08" in rate_words(SWEEPING)


def test_progress_before_the_first_scan_is_zero_not_an_error():
    assert fraction_done(IDLE) == 0.0


def test_the_bar_is_as_wide_as_told_whatever_the_fraction():
    assert [len(bar(fraction, 10)) for fraction in (-1, 0, 0.5, 1, 7)] == [10] * 5


def test_every_sign_has_a_plain_one_of_the_same_width():
    signs = bar(0.5, 4) + sparkline([0, 1, 2, 3, 4, 5, 6, 7], 8) + "".join(sign.glyph for sign in SIGNS.values())
    plain = to_ascii(Text(signs, "bold")).plain
    assert plain.isascii() and len(plain) == len(signs)


def test_the_banner_shows_the_newest_fault_that_nobody_acknowledged():
    def fault(code, at, acknowledged=False):
        return FaultReport(code=code, happened="", safe="", to_do="", at_mono_ns=at, acknowledged=acknowledged)

    found = newest_fault([fault("F01", 1), fault("F02", 2), fault("F03", 3, acknowledged=True)])
    assert found is not None and found.code == "F02"
    assert newest_fault([fault("F03", 3, acknowledged=True)]) is None


def test_the_scan_is_called_by_its_folder():
    assert scan_name(SWEEPING) == "20260101T120000Z-stirrup"


def test_the_progress_line_counts_points_of_both_kinds():
    assert f"{PROGRESS.points_settled + PROGRESS.points_provisional} points" in progress_line(SWEEPING, PROGRESS)


def test_status_in_words_has_every_count():
    text = "\n".join(status_lines(SWEEPING))
    for words in ("triggered 413", "received 412", "committed 410", "durable 384", "credit 105 of 108"):
        assert words in text


def test_shortened_text_keeps_both_ends():
    assert shorten("a" * 10 + "b" * 10, 11) == "aaaa...bbbb"


def test_short_text_stays_as_it_is():
    assert shorten("abc", 3) == "abc"


def test_wide_characters_take_two_cells_each():
    assert cell_len(shorten("漢字" * 10, 12)) <= 12 and cell_len(shorten("漢字", 3)) <= 3


@pytest.mark.parametrize("text", ["", "1024", "0x768", "1024X768", "1024x768x3", "-1x5", "1e3x768"])
def test_a_size_that_is_none_is_refused_with_an_example(text):
    with pytest.raises(ValueError, match="1024x768"):
        parse_size(text)


def test_status_says_what_runs_beside_a_sweep_who_holds_control_and_what_was_proposed():
    proposal = Proposal(
        first_steps=300, last_steps=1020, exposure_ms=15.0, frames=241, seconds=20.0, nbytes=1, free_bytes=2,
        warnings=["it is lit in the first look"],
    )  # fmt: skip
    said = status_lines(
        replace(IDLE, activity="prescan", activity_share=0.42, control="anna on pts/3", proposal=proposal)
    )
    assert "doing     prescan  42 %" in said and "control   anna on pts/3" in said
    assert "proposal  300 to 1020, 241 frames, 15 ms" in said and "warning   it is lit in the first look" in said
    assert not any(line.startswith(("doing", "control", "proposal")) for line in status_lines(IDLE))


def test_what_a_busy_worker_says_with_each_frame_is_one_line_of_the_log_for_each_scan():
    log = SessionLog()

    def logged(words: str, scan_uid: str = "a") -> list[str]:
        count = len(log.lines)
        log.take_progress(msgspec.structs.replace(PROGRESS, scan_uid=scan_uid, message=words))
        return [line.text for line in list(log.lines)[count:]]

    assert logged("reading frame 7 from the scan file") == ["worker: reading frame 7 from the scan file"]
    assert logged("") == logged("reading frame 9 from the scan file") == []
    assert logged("no calibration") == ["worker: no calibration"]
    assert len(logged("reading frame 2 from the scan file", "b")) == 1
