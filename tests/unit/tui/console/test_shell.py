"""What holds on every screen of the console: lists of actions, control, read-only, keys, themes, random keys."""

from __future__ import annotations

import random

import pytest

from acquire.contract.messaging.messages import Picture
from acquire.contract.states import State
from tests.fakes.fake_daemon import IDLE, PROGRESS, SWEEPING, wandering_disc
from tests.unit.tui.console.played_console import ME, play
from tests.unit.tui.console.test_console import FAULT, replace
from tui.console.link.messages import CommandAnswered, LinkChanged, PictureArrived, ProgressArrived, StatusArrived
from tui.console.link.rig_view import PictureView
from tui.console.screen_table import SCREENS
from tui.console.screens.dialogs import FormDialog, LineInput
from tui.console.screens.scan_dialogs import AdjustDialog
from tui.console.widgets.frame import Header, KeyLine
from tui.console.widgets.scan_panes import LightPane, PlanPane, StagePane

SETTINGS = {"exposure_ms": 30.0, "gain": 6.0, "brightness_percent": 0.0}
LIMITS = {"exposure_ms": (0.1, 500.0), "gain": (0.0, 24.0), "brightness_percent": (0.0, 10.0)}
READY = replace(IDLE, camera=SETTINGS, camera_limits=LIMITS)


def test_number_keys_switch_screens_and_stop_works_on_each():
    async def script(console):
        await console.connect()
        for number, entry in enumerate(SCREENS, 1):
            await console.press(str(number))
            assert entry.name == console.app.rig_screen.NAME
            assert "SPACE = STOP" in console.shown(KeyLine) and "IDLE" in console.shown(Header)
            await console.press("space")
        assert [name for name, _ in console.sent].count("stop") == len(SCREENS)

    play(script)


def test_an_ascii_console_paints_nothing_but_ascii_on_any_screen():
    async def script(console):
        await console.connect(replace(SWEEPING, faults=[FAULT]))
        for number, entry in enumerate(SCREENS, 1):
            await console.press(str(number))
            others = {sign for sign in console.painted if not sign.isascii()}
            assert not others, f"{entry.name}: {others}"
        await console.press("question_mark")
        assert console.painted.isascii()

    play(script, ascii_only=True)


def test_help_is_searched_and_runs_what_was_chosen():
    async def script(console):
        await console.connect()
        await console.press("question_mark")
        await console.press(*"lamp")
        assert len(console.app.screen.found) == 1
        await console.press("enter")
        assert console.sent == [("lamp", {"on": True})]

    play(script)


def test_help_says_why_an_action_cannot_be_done_now():
    async def script(console):
        await console.connect(SWEEPING)
        await console.press("question_mark")
        found = {entry.action: entry.why_not for entry in console.app.screen.entries}
        assert "a scan is running" in found["start"] and not found["pause"]

    play(script)


def test_the_palette_goes_to_another_screen():
    async def script(console):
        await console.connect()
        await console.press("colon")
        await console.press(*"gotoscans".replace("goto", "go_to_"))
        await console.press("enter")
        assert console.app.rig_screen.NAME == "scans"

    play(script)


def test_every_action_has_a_key_an_id_and_words():
    async def script(console):
        await console.connect()
        for entry in SCREENS:
            screen = console.app.screen_named(entry.name)
            keys = [console.app.key_label(binding) for binding in screen.actions()]
            assert len(set(keys)) == len(keys), f"two actions of {entry.name} share a key: {sorted(keys)}"
            assert all(binding.id and binding.description for binding in screen.actions())

    play(script)


def test_while_somebody_else_holds_control_nothing_is_sent_but_stop_and_the_holder_is_named():
    async def script(console):
        await console.connect(replace(READY, control="ben on pts/9"))
        await console.press("h", "L", "s", "comma")
        assert console.sent == []
        assert "ben on pts/9 holds control: T takes it" in console.log
        await console.press("3")
        assert "control: ben on pts/9" in console.shown(Header)
        await console.press("space", "T")
        assert console.sent == [("stop", {}), ("control", {"action": "take"})]

    play(script)


def test_control_that_is_ours_is_given_back_by_the_same_key():
    async def script(console):
        await console.connect(replace(READY, control=ME))
        assert "control: you" in console.shown(Header)
        await console.press("T")
        assert console.sent == [("control", {"action": "release"})]

    play(script)


def test_a_read_only_console_has_no_action_that_moves_and_sends_none_but_has_stop():
    async def script(console):
        await console.connect(READY)
        names = {binding.action for binding in console.app.rig_screen.actions()}
        assert not names & {"start", "home", "jog(1)", "lamp", "control", "acknowledge"} and "set_first" in names
        await console.press("h", "s", "L", "comma", "j", "T", "v", "x", "e")
        console.app.send_command("jog", {"steps": 3})
        assert console.sent == []
        assert "read-only" in console.shown(Header) and "home" not in console.shown(KeyLine)
        await console.press("space")
        assert console.sent == [("stop", {})]

    play(script, read_only=True)


def test_jog_sends_one_bounded_move_and_keeps_at_most_one():
    async def script(console):
        await console.connect(replace(READY, position_steps=100))
        await console.press(*["full_stop"] * 8)
        assert console.sent == [("jog", {"steps": 3})]

    play(script)


def test_jog_at_the_limit_is_explained_and_not_sent():
    async def script(console):
        await console.connect(replace(READY, position_steps=4500))
        await console.press("full_stop")
        assert console.sent == []
        assert "the upper limit is 4500 microsteps" in console.log

    play(script)


def test_a_held_jog_sends_a_lease_with_its_direction():
    async def script(console):
        await console.connect(READY)
        await console.press("k")
        assert console.sent[0][0] == "jog_hold" and console.sent[0][1]["direction"] == 1

    play(script)


def test_first_and_last_are_set_from_where_the_stage_is():
    async def script(console):
        await console.connect(replace(READY, position_steps=120))
        await console.press("f")
        await console.hear(StatusArrived(replace(READY, position_steps=900)))
        await console.press("l")
        assert "first    120" in console.shown(PlanPane) and "last     900" in console.shown(PlanPane)
        await console.press("s")
        await console.press("enter")
        assert console.sent[0][1]["first_steps"] == 120 and console.sent[0][1]["last_steps"] == 900

    play(script)


def test_the_exposure_is_stepped_at_once_and_a_number_out_of_limits_is_refused():
    async def script(console):
        await console.connect(replace(READY, state=State.PREVIEW, activity="preview"))
        await console.press("e")
        await console.press("up")
        name, args = console.sent[0]
        assert name == "camera" and args["exposure_ms"] > 30.0
        await console.press(*"9999", "enter")
        assert isinstance(console.app.screen, AdjustDialog) and len(console.sent) == 1

    play(script)


def test_settings_that_change_quickly_are_sent_one_at_a_time_and_the_newest_last():
    async def script(console):
        await console.connect(READY)
        await console.press("g")
        await console.press("up", "up", "up", "up")
        assert len(console.sent) == 1
        number = [name for name, _ in console.link.sent].index("camera") + 1
        await console.hear(CommandAnswered("camera", True, "", 1, f"request-{number}"))
        assert len(console.sent) == 2 and console.sent[1][1]["gain"] == console.app.screen.value

    play(script)


def stops(console) -> int:
    return sum(name == "stop" for name, _ in console.link.sent)


@pytest.mark.parametrize("key", ["i", "question_mark", "colon"])
def test_in_a_dialog_with_fields_for_text_space_is_a_space_and_ctrl_x_is_stop(key):
    async def script(console):
        await console.connect(SWEEPING)
        assert "SPACE = STOP" in console.painted
        await console.press(key, *"a_", "space", *"b")
        field = console.app.screen.query(LineInput).first()
        assert field.value == "a_ b" and stops(console) == 0
        assert "CTRL+X = STOP" in console.painted and "SPACE = STOP" not in console.painted
        await console.press("ctrl+x")
        assert stops(console) == 1 and field.value == "a_ b"
        await console.press("escape")
        assert "SPACE = STOP" in console.painted
        await console.press("space")
        assert stops(console) == 2

    play(script)


def test_the_specimen_is_typed_with_its_spaces_in_mid_sweep():
    async def script(console):
        await console.connect(SWEEPING)
        await console.press("i", "tab", *"left", "space", *"ear", "enter")
        assert console.app.state.next_scan.specimen == "left ear" and stops(console) == 0

    play(script)


def test_the_estimate_is_asked_for_by_itself_and_its_warning_is_shown():
    async def script(console):
        await console.connect(READY)
        while not [name for name, _ in console.link.sent if name == "estimate"]:
            await console.pilot.pause(0.05)
        result = {"expected": 527, "seconds": 35.0, "bytes": 4e8, "free_bytes": 1e11, "warnings": ["the lamp is off"]}
        await console.hear(CommandAnswered("estimate", True, "", 1, "request-1", result))
        assert "527 frames  0:00:35" in console.shown(PlanPane) and "! the lamp is off" in console.shown(PlanPane)

    play(script)


def test_the_panes_show_keys_that_the_operator_chose():
    async def script(console):
        await console.connect(READY)
        assert "H home" in console.shown(StagePane)
        await console.press("h", "H")
        assert [name for name, _ in console.sent] == ["home"]

    play(script, size=(100, 30), keymap={"scan.home": "H"})


def test_colours_change_by_key_and_nothing_else_does():
    async def script(console):
        await console.connect()
        before = console.shown(LightPane)
        await console.press("ctrl+t", "ctrl+t")
        assert console.app.theme == "sweepscope-contrast" and console.shown(LightPane) == before

    play(script)


def test_pictures_are_wanted_only_while_a_screen_shows_them():
    async def script(console):
        await console.connect()
        assert console.link.pictures_wanted
        await console.press("6")
        assert not console.link.pictures_wanted

    play(script)


def test_screens_and_keys_can_be_clicked():
    async def script(console):
        await console.connect()
        await console.pilot.click(Header, offset=(60, 1))
        await console.pilot.pause()
        assert console.app.rig_screen.NAME == "log"
        await console.press("1")
        await console.pilot.click(KeyLine, offset=(3, 0))
        await console.pilot.pause()
        assert isinstance(console.app.screen, FormDialog)

    play(script)


KEYS = [
    *"abcdefghijklmnoprstuvwxyzLTV123456789?:.,<>[]_-",
    *("space", "enter", "escape", "tab", "up", "down", "left", "right", "pageup", "pagedown", "backspace", "ctrl+t"),
]


@pytest.mark.parametrize("seed", [2])
def test_random_keys_and_states_never_crash_the_console(seed):
    chance = random.Random(seed)  # noqa: S311
    states = [IDLE, READY, SWEEPING, replace(SWEEPING, faults=[FAULT]), replace(READY, control="ben on pts/9")]

    async def script(console):
        for number in range(100):
            await console.pilot.press(chance.choice(KEYS))
            if number % 10 == 0:
                picture = PictureView(Picture(shape=[192, 256], source_shape=[768, 1024]), wandering_disc(number))
                news = [StatusArrived(chance.choice(states)), ProgressArrived(PROGRESS), PictureArrived(picture)]
                await console.hear(LinkChanged(chance.random() < 0.8, "there"), *news)
            if number % 40 == 0:
                await console.pilot.resize_terminal(chance.randint(30, 170), chance.randint(8, 55))
        assert console.app.is_running

    play(script)
