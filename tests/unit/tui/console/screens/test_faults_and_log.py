"""The screens of faults and of the log: nothing that was said is hidden, everything can be taken along as text."""

from __future__ import annotations

import msgspec

from acquire.contract.faults import report
from tests.fakes.fake_daemon import IDLE
from tests.unit.tui.console.played_console import play
from tui.console.link.messages import StatusArrived
from tui.console.screens.faults import FaultDetail
from tui.console.screens.log import filtered
from tui.console.state.fault_log import FaultLog
from tui.console.state.session_log import LogLine
from tui.console.widgets.log_pane import LogPane
from tui.console.widgets.rows import RowList

WRITER = report("F03", 10**9, committed=410, expected=527)
NOISE = report("F11", 2 * 10**9, detail="block 7")


def having(*faults):
    return msgspec.structs.replace(IDLE, faults=list(faults))


def seen(fault):
    return msgspec.structs.replace(fault, acknowledged=True)


def test_each_fault_shows_what_happened_what_is_safe_what_to_do_and_when():
    async def script(console):
        await console.connect(having(WRITER, NOISE))
        assert "2, 2 not acknowledged" in str(console.screen.query_one(RowList).border_title)
        detail = console.shown(FaultDetail)
        assert "F11" in detail and "NOT ACKNOWLEDGED" in detail
        await console.press("down")
        for words in ("F03 the writer is lost", "410 of 527 frames are saved", "it is being restarted", "when"):
            assert words in console.shown(FaultDetail)

    play(script, screen="faults")


def test_an_acknowledged_fault_and_one_that_the_daemon_forgot_stay_on_the_list():
    async def script(console):
        await console.connect(having(WRITER))
        await console.hear(StatusArrived(having(seen(WRITER))))
        assert "acknowledged" in console.shown(FaultDetail) and "NOT" not in console.shown(FaultDetail)
        await console.hear(StatusArrived(having()))
        assert "the writer is lost" in console.shown(RowList)
        assert "the daemon no longer reports it" in console.shown(FaultDetail)

    play(script, screen="faults")


def test_faults_that_came_while_another_screen_was_in_view_are_there():
    async def script(console):
        await console.connect(having(WRITER))
        await console.hear(StatusArrived(having()))
        await console.press("5")
        assert "the writer is lost" in console.shown(RowList)

    play(script, screen="log")


def test_all_are_acknowledged_with_one_key_and_without_any_it_says_so():
    async def script(console):
        await console.connect(having())
        await console.press("A")
        assert console.sent == [] and "every fault is acknowledged" in console.log
        await console.hear(StatusArrived(having(WRITER, NOISE)))
        await console.press("A")
        assert console.link.sent == [("acknowledge", {"code": ""})]

    play(script, screen="faults")


def test_faults_are_copied_as_text():
    async def script(console):
        await console.connect(having(WRITER, NOISE))
        await console.press("C")
        text = console.app.clipboard
        for words in ("F03", "F11", "safe:", "to do:", "not acknowledged"):
            assert words in text

    play(script, screen="faults")


def test_the_log_of_faults_is_bounded_and_newest_first():
    log = FaultLog(wall_time=str)
    for number in range(600):
        log.take([report("F11", number, detail=str(number))])
    assert len(log.faults) == 500 and log.faults[0].report.at_mono_ns == 599
    assert not log.faults[1].current


def test_lines_are_filtered_by_level_and_by_all_words():
    lines = [LogLine("1", "info", "frame taken"), LogLine("2", "warning", "lamp dim"), LogLine("3", "error", "no lamp")]
    assert [line.at for line in filtered(lines, 0, "")] == ["1", "2", "3"]
    assert [line.at for line in filtered(lines, 1, "")] == ["2", "3"]
    assert [line.at for line in filtered(lines, 2, "")] == ["3"]
    assert [line.at for line in filtered(lines, 0, "LAMP no")] == ["3"]


def test_the_log_is_filtered_from_the_keyboard_and_shown_whole_again():
    async def script(console):
        await console.connect()
        console.app.say("the lamp is dim", "warning")
        await console.press("l")
        assert "the lamp is dim" in console.shown(LogPane) and "connected to" not in console.shown(LogPane)
        await console.press("l", "l", "slash", *"dim", "enter")
        assert console.shown(LogPane).count("\n") == 0 and "with 'dim'" in str(
            console.screen.query_one(LogPane).border_title
        )
        await console.press("escape")
        assert "connected to" in console.shown(LogPane)

    play(script, screen="log")


def test_a_log_that_was_scrolled_back_stands_still_until_it_is_told_to_follow():
    async def script(console):
        for number in range(100):
            console.app.say(f"line number {number}")
        await console.pilot.pause()
        assert "line number 99" in console.shown(LogPane)
        await console.press("pageup")
        shown = console.shown(LogPane)
        console.app.say("one more")
        await console.pilot.pause()
        assert console.shown(LogPane) == shown and "scrolled back" in str(
            console.screen.query_one(LogPane).border_title
        )
        await console.press("end")
        assert "one more" in console.shown(LogPane)

    play(script, screen="log")


def test_the_lines_in_the_filter_are_copied():
    async def script(console):
        console.app.say("only this", "error")
        await console.press("l", "l", "c")
        assert console.app.clipboard == "12:00:00 error: only this\n"

    play(script, screen="log")
