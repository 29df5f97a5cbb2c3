"""The console with a connection that the test plays."""

from __future__ import annotations

import msgspec
import pytest

from acquire.contract.messaging.messages import FaultReport, ResultEnd
from acquire.contract.states import HoldReason, Outcome, State
from tests.fakes.fake_daemon import IDLE, PROGRESS, SWEEPING
from tests.fakes.fake_link import FakeLink
from tests.unit.tui.console.played_console import play
from tui.console.link.messages import (
    CommandAnswered,
    LinkChanged,
    PageKnown,
    ProgressArrived,
    ResultsOnDisk,
    StatusArrived,
)
from tui.console.screens.actions import ActionList
from tui.console.screens.dialogs import Confirm, FormDialog, LineInput
from tui.console.state.scan_forms import numbered
from tui.console.widgets.frame import FaultBanner, Header, KeyLine
from tui.console.widgets.scan_panes import PlanPane, ProgressPane, StagePane

URL = "http://127.0.0.1:8080/?token=secret"
FAULT = FaultReport(
    code="F03", happened="the writer is lost", safe="410 of 527 frames are saved", to_do="nothing", at_mono_ns=7
)


def replace(status, **changes):
    return msgspec.structs.replace(status, **changes)


def test_before_anything_is_heard_the_console_says_that_it_is_not_connected():
    async def script(console):
        assert "NOT CONNECTED - RETRYING" in console.shown(Header)
        assert console.link.started

    play(script)


def test_state_position_counts_and_rate_are_shown():
    async def script(console):
        await console.connect(SWEEPING)
        await console.hear(ProgressArrived(PROGRESS), PageKnown(URL))
        assert "SWEEPING" in console.shown(Header)
        assert "3 924.3 um  1236 microsteps  trusted" in console.shown(StagePane)
        sweep = console.shown(ProgressPane)
        for words in ("410/527  78 %", "14.8 frames/s", "0:00:08", "credit 105 of 108"):
            assert words in sweep
        assert "lag: camera 1 writer 2 disk 26 worker 3" in sweep
        assert "48213 points, 2911 provisional" in sweep
        assert URL in console.shown(Header)

    play(script)


def test_a_lost_daemon_is_said_and_the_last_known_state_is_marked_as_that():
    async def script(console):
        await console.connect(SWEEPING)
        await console.hear(LinkChanged(False, "no rig daemon is heard"))
        assert "last known: SWEEPING" in console.shown(Header)
        assert "NOT CONNECTED - RETRYING" in console.shown(Header)

    play(script)


def test_start_asks_what_is_scanned_with_the_last_name_numbered_on():
    async def script(console):
        await console.connect(replace(IDLE, scan_path="/data/20260101T120000Z-left-ear", outcome=Outcome.COMPLETE))
        await console.press("s")
        assert isinstance(console.app.screen, FormDialog)
        await console.press("enter")
        assert [name for name, _ in console.sent] == ["scan"]
        assert console.sent[0][1]["name"] == "left-ear-2"

    play(script)


def test_the_start_dialog_shows_the_free_space_of_now_and_why_it_would_be_refused():
    async def script(console):
        await console.connect()
        await console.press("s")
        number = [name for name, _ in console.link.sent].index("estimate") + 1
        refused = (
            "the scan needs 415.2 MB and 0 B are free in /data: make room, or set storage.data_dir to another disk"
        )
        await console.hear(CommandAnswered("estimate", False, refused, 1, f"request-{number}"))
        shown = " ".join(console.painted.replace("│", " ").split())
        assert isinstance(console.app.screen, FormDialog) and "0 B are free" in shown and "another disk" in shown

    play(script, size=(80, 24))


def test_a_sweep_without_a_cloud_says_so_beside_its_outcome():
    async def script(console):
        saved = replace(IDLE, scan_uid=PROGRESS.scan_uid, scan_path="/data/a", outcome=Outcome.COMPLETE, expected=8)
        await console.connect(replace(saved, committed=8))
        why = "no maps: cannot write /data/a: a full disk; the scan is safe, 'sweepscope reconstruct' makes them"
        await console.hear(ProgressArrived(replace(PROGRESS, message=why, failed=True)))
        shown = " ".join(console.shown(ProgressPane).split())
        assert "SAVED: 8 of 8" in shown and "NO CLOUD: no maps: cannot write" in shown and "reconstruct" in shown
        assert any(line.level == "error" and "full disk" in line.text for line in console.app.state.log.lines)

    play(script, size=(160, 50))


@pytest.mark.parametrize(
    ("command", "words"), [("prescan", "begun"), ("goto", "begun"), ("home", "begun"), ("lamp", "done")]
)
def test_a_reply_says_begun_where_the_work_goes_on(command, words):
    async def script(console):
        await console.connect()
        await console.hear(CommandAnswered(command, True, "", 1, "request-x"))
        assert f"{command}: {words}" in console.log

    play(script)


def test_the_specimen_is_asked_for_at_each_start_and_kept_for_the_next():
    async def script(console):
        await console.connect()
        await console.press("s", "tab", *"bone", "space", "7", "tab", *"ann", "enter")
        assert console.sent[0][1]["specimen"] == "bone 7" and console.sent[0][1]["operator"].endswith("ann")
        await console.press("s")
        assert [field.value for field in console.app.screen.query(LineInput)][1] == "bone 7"

    play(script)


@pytest.mark.parametrize(
    ("name", "following"), [("ear", "ear-2"), ("ear-2", "ear-3"), ("ear-99", "ear-100"), ("2026-11-30", "2026-11-30-2")]
)
def test_a_name_is_numbered_on(name, following):
    assert numbered(name) == following


def test_bounds_that_one_key_overwrote_come_back_with_undo():
    async def script(console):
        await console.connect(replace(IDLE, position_steps=700, position_trusted=True))
        before = console.app.state.next_scan
        await console.press("U")
        assert "undo: nothing to undo" in console.log
        await console.press("l", "m")
        assert console.app.state.next_scan.last_steps == 700 and console.app.state.next_scan.mode == "fly"
        await console.press("U", "U")
        assert console.app.state.next_scan == before

    play(script)


def test_the_zero_is_set_only_after_a_question():
    async def script(console):
        await console.connect(replace(IDLE, position_trusted=True))
        await console.press("z")
        assert isinstance(console.app.screen, Confirm) and console.sent == []
        await console.press("n", "z")
        await console.pilot.pause(0.4)
        await console.press("y")
        assert console.sent == [("zero", {})]

    play(script)


def test_a_typed_name_replaces_the_default():
    async def script(console):
        await console.connect()
        await console.press("s")
        await console.press(*"ear2", "enter")
        assert console.sent[0][1]["name"] == "ear2"

    play(script)


def test_escape_starts_nothing():
    async def script(console):
        await console.connect()
        await console.press("s", "escape")
        assert console.sent == []

    play(script)


def test_a_name_with_a_slash_is_refused_and_the_question_stays():
    async def script(console):
        await console.connect()
        await console.press("s")
        await console.press("a", "slash", "b", "enter")
        assert isinstance(console.app.screen, FormDialog)
        assert console.sent == []

    play(script)


def test_start_while_a_sweep_runs_is_explained_and_not_sent():
    async def script(console):
        await console.connect(SWEEPING)
        await console.press("s")
        assert console.sent == []
        assert "start: a scan is running; stop it first" in console.log

    play(script)


def test_pause_and_resume_are_sent_in_their_states():
    async def script(console):
        await console.connect(SWEEPING)
        await console.press("p")
        await console.hear(StatusArrived(replace(SWEEPING, state=State.HOLDING, hold_reason=HoldReason.PAUSED)))
        assert "HOLDING (paused)" in console.shown(Header)
        await console.press("r")
        assert [name for name, _ in console.sent] == ["pause", "resume"]

    play(script)


def test_stop_works_from_the_main_screen_and_from_every_dialog():
    async def script(console):
        await console.connect(SWEEPING)
        await console.press("space")
        await console.press("question_mark")
        assert isinstance(console.app.screen, ActionList)
        await console.press("ctrl+x", "escape", "q")
        assert isinstance(console.app.screen, Confirm)
        await console.press("space", "n")
        await console.hear(StatusArrived(IDLE))
        await console.press("s")
        assert isinstance(console.app.screen, FormDialog)
        await console.press("ctrl+x")
        assert [name for name, _ in console.sent] == ["stop"] * 4

    play(script, owns_rig=True)


def test_space_stops_even_when_nothing_is_known_of_the_rig():
    async def script(console):
        await console.press("space")
        assert console.sent == [("stop", {})]

    play(script)


def test_stop_is_confirmed_only_by_a_state_that_was_said_after_the_daemon_took_it():
    async def script(console):
        await console.connect(SWEEPING)
        await console.press("space")
        assert "STOP sent" in console.shown(Header)
        await console.hear(StatusArrived(replace(IDLE, sent_mono_ns=50)))
        assert "stopped at" not in console.log
        await console.hear(CommandAnswered("stop", True, "", at_mono_ns=100))
        await console.hear(StatusArrived(replace(IDLE, sent_mono_ns=99)))
        assert "stopped at" not in console.log
        await console.hear(StatusArrived(replace(IDLE, sent_mono_ns=101, position_steps=1236)))
        assert "stopped at" in console.log and "1236 microsteps" in console.log
        assert "STOP" not in console.shown(Header)

    play(script)


def test_a_stop_that_is_confirmed_before_its_key_came_through_is_logged_in_order():
    async def script(console):
        await console.connect(SWEEPING)
        console.app.stop_early()
        await console.hear(CommandAnswered("stop", True, "", at_mono_ns=100))
        await console.hear(StatusArrived(replace(IDLE, sent_mono_ns=101)))
        await console.press("space")
        assert console.log.index("STOP sent") < console.log.index("stopped at") and console.log.count("STOP sent") == 1
        assert console.sent == [("stop", {})]

    play(script)


def test_a_stop_that_nobody_answered_is_called_not_confirmed():
    async def script(console):
        await console.connect(SWEEPING)
        await console.press("space")
        await console.hear(CommandAnswered("stop", False, "no answer", at_mono_ns=100))
        assert "STOP NOT CONFIRMED" in console.shown(Header)

    play(script)


def test_a_refused_command_is_shown_with_the_daemons_reason():
    async def script(console):
        await console.connect()
        await console.hear(CommandAnswered("scan", False, "the disk is full: 3.0 GB are needed"))
        assert "scan: the disk is full: 3.0 GB are needed" in console.log

    play(script)


def test_a_fault_is_a_banner_until_it_is_acknowledged_and_stays_in_the_log():
    async def script(console):
        await console.connect(replace(SWEEPING, faults=[FAULT]))
        banner = console.shown(FaultBanner)
        for words in ("F03", "the writer is lost", "410 of 527 frames are saved", "nothing"):
            assert words in banner
        assert console.app.rig_screen.query_one(FaultBanner).display
        await console.press("a")
        assert console.sent == [("acknowledge", {"code": "F03"})]
        await console.hear(StatusArrived(replace(SWEEPING, faults=[replace(FAULT, acknowledged=True)])))
        assert not console.app.rig_screen.query_one(FaultBanner).display
        assert "F03 the writer is lost" in console.log

    play(script)


def test_the_same_fault_is_logged_once_however_often_it_is_repeated():
    async def script(console):
        for _ in range(5):
            await console.connect(replace(SWEEPING, faults=[FAULT]))
        assert console.log.count("F03") == 1

    play(script)


def test_quitting_a_console_that_owns_the_rig_asks_while_a_sweep_runs():
    async def script(console):
        await console.connect(SWEEPING)
        await console.press("q")
        assert isinstance(console.app.screen, Confirm)
        await console.press("n")
        assert console.app.is_running and not isinstance(console.app.screen, Confirm)

    play(script, owns_rig=True)


@pytest.mark.parametrize(("owns_rig", "words"), [(True, "asks first"), (False, "goes on without this screen")])
def test_the_help_says_what_leaving_does_to_a_sweep(owns_rig, words):
    async def script(console):
        await console.connect(SWEEPING)
        await console.press("question_mark")
        (entry,) = [entry for entry in console.app.screen.entries if entry.action == "quit"]
        assert words in entry.words and (entry.key == "q")

    play(script, owns_rig=owns_rig)


def test_a_console_that_owns_the_rig_asks_also_while_the_rig_is_not_heard():
    async def script(console):
        await console.connect(SWEEPING)
        await console.hear(LinkChanged(connected=False, detail="nothing is heard"))
        await console.press("q")
        assert isinstance(console.app.screen, Confirm)

    play(script, owns_rig=True)


def test_an_answer_typed_before_the_question_could_be_read_does_not_count():
    now_s = [100.0]

    async def script(console):
        await console.connect(SWEEPING)
        await console.press("q", "y")
        assert isinstance(console.app.screen, Confirm)
        now_s[0] += 0.4
        await console.press("y")
        assert not isinstance(console.app.screen, Confirm)

    play(script, owns_rig=True, now_s=lambda: now_s[0])


def test_quitting_a_plain_console_never_asks():
    async def script(console):
        await console.connect(SWEEPING)
        await console.press("q")
        assert not console.app.is_running

    play(script)


def test_saved_appears_when_the_sealed_scan_lacks_nothing():
    async def script(console):
        await console.connect(SWEEPING)
        assert "SAVED" not in console.shown(PlanPane)
        done = {"committed": 527, "durable": 527, "outcome": Outcome.COMPLETE}
        await console.hear(StatusArrived(replace(SWEEPING, state=State.FINISHING, **done)))
        assert "SAVED" not in console.shown(PlanPane) + console.log
        await console.hear(StatusArrived(replace(SWEEPING, state=State.IDLE, **done)))
        assert "SAVED: 527 of 527 frames are safe" in console.shown(PlanPane)
        assert "SAVED: 527 of 527 frames are safe" in console.log

    play(script)


def test_a_cloud_on_disk_is_told_with_its_path():
    async def script(console):
        end = ResultEnd(version=1, outcome="complete", folded_through=526, points=51_124, cloud_path="/d/cloud.ply")
        await console.hear(ResultsOnDisk(end))
        assert "51124 points in /d/cloud.ply" in console.log

    play(script)


def test_the_key_line_offers_what_can_be_done_now_and_always_stop():
    async def script(console):
        assert "SPACE = STOP" in console.shown(KeyLine) and "start" not in console.shown(KeyLine)
        await console.connect()
        assert "s start" in console.shown(KeyLine)
        await console.hear(StatusArrived(SWEEPING))
        assert "p pause" in console.shown(KeyLine) and "s start" not in console.shown(KeyLine)

    play(script)


def test_a_terminal_that_is_too_small_says_so_and_stop_still_works():
    async def script(console):
        await console.connect(SWEEPING)
        await console.pilot.resize_terminal(50, 15)
        await console.pilot.pause()
        assert console.app.rig_screen.has_class("small")
        await console.press("space")
        assert console.sent == [("stop", {})]

    play(script)


def test_an_ascii_console_shows_ascii_only_in_its_panes():
    async def script(console):
        await console.connect(replace(SWEEPING, faults=[FAULT]))
        for pane in (Header, ProgressPane, FaultBanner, Header, KeyLine):
            assert console.shown(pane).isascii()

    play(script, ascii_only=True)


def test_leaving_closes_the_connection():
    async def script(console):
        link = console.link
        await console.press("q")
        await console.pilot.pause()
        links.append(link)

    links: list[FakeLink] = []
    play(script)
    assert links[0].closed


def test_resume_of_a_sweep_that_holds_by_itself_is_explained_and_not_sent():
    async def script(console):
        await console.connect(replace(SWEEPING, state=State.HOLDING, hold_reason=HoldReason.NO_CREDIT))
        await console.press("r")
        assert console.sent == []
        assert "goes on by itself" in console.log

    play(script)


def test_a_message_that_repeats_a_fault_or_the_outcome_is_not_logged_twice():
    async def script(console):
        await console.connect(replace(SWEEPING, faults=[FAULT], message="F03 the writer is lost: 410 of 527"))
        ended = replace(SWEEPING, state=State.IDLE, outcome=Outcome.STOPPED, message="")
        words = "stopped: 410 of 527 frames are safe"
        await console.hear(StatusArrived(ended), StatusArrived(replace(ended, message=f"{words} (by the operator)")))
        assert console.log.count("F03") == 1 and console.log.count(words) == 1

    play(script)
