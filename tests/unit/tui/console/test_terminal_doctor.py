"""What the console's doctor finds, and which colours are used."""

from __future__ import annotations

import pytest

from tui.console.terminal.doctor import Measured, findings
from tui.console.terminal.terminal import choose_colours, colours_of, picture_mode

GOOD = {"TERM": "xterm-256color", "COLORTERM": "truecolor", "LANG": "en_US.UTF-8"}
FAST = Measured(0.005, None, synchronised=True)


def fixes(environ=GOOD, size=(80, 24), measured=FAST, tmux=None) -> dict[str, str]:
    return {found.name: found.fix for found in findings(environ, size, measured, tmux or {}) if found.fix}


def test_a_good_terminal_needs_no_fix():
    assert fixes() == {}


@pytest.mark.parametrize(
    ("wrong", "name", "words"),
    [
        ({"environ": GOOD | {"TERM": "dumb"}}, "TERM", "xterm-256color"),
        ({"environ": GOOD | {"LANG": "C"}}, "locale", "--ascii"),
        ({"size": (50, 24)}, "size", "60 x 20"),
        ({"measured": Measured(0.2, 40_000.0, synchronised=False)}, "link", "ssh -C"),
        ({"measured": Measured(None, None, synchronised=False)}, "round trip", "queue"),
        ({"environ": GOOD | {"TMUX": "x"}, "tmux": {"escape-time": "500"}}, "tmux escape-time", "escape-time 20"),
    ],
)
def test_each_shortcoming_comes_with_its_fix(wrong, name, words):
    assert words in fixes(**wrong)[name]


@pytest.mark.parametrize(
    ("environ", "colours"),
    [
        (GOOD, "truecolor"),
        ({"TERM": "xterm-256color"}, "256"),
        ({"TERM": "linux"}, "16"),
        (GOOD | {"NO_COLOR": ""}, "none"),
    ],
)
def test_colours_are_only_those_that_the_terminal_says_it_has(environ, colours):
    assert colours_of(environ) == colours
    assert colours_of(environ, "16") == "16"


def test_the_picture_falls_back_to_characters_without_grey_levels_or_in_ascii():
    assert picture_mode("256", ascii_only=False) == "half"
    assert picture_mode("16", ascii_only=False) == picture_mode("256", ascii_only=True) == "mono"


def test_no_colour_is_passed_on_and_keys_stay_plain_within_tmux():
    environ = {"TERM": "xterm-256color", "TMUX": "x"}
    assert choose_colours("none", environ) == "none"
    assert environ["NO_COLOR"] and environ["TEXTUAL_DISABLE_KITTY_KEY"] == "1"
