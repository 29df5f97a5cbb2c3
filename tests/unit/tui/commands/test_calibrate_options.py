"""Options of the calibration commands: squares as people write them, and numbers that are finite and in range."""

from __future__ import annotations

from collections.abc import Callable

import click
import pytest

from tui import cli
from tui.commands.calibrate import calibrate
from tui.commands.context import Number
from tui.text.sizes import parse_squares


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Run a command line: status, stdout, stderr."""

    def run(*arguments: str) -> tuple[int, str, str]:
        status = cli.run(arguments)
        said = capsys.readouterr()
        return status, said.out, said.err

    return run


@pytest.mark.parametrize(
    "text", ["10x7", "10X7", "10 x 7", "10*7", "10,7", "10, 7", " 10x7 ", "10\u00d77", "10/7", "10 7"]
)
def test_squares_are_taken_as_people_write_them(text):
    assert parse_squares(text) == (10, 7)


@pytest.mark.parametrize("text", ["", "10", "10x", "x7", "-10x7", "10.5x7", "10x7x3", "nanxinf", "\u0661\u0660x7"])
def test_what_is_no_board_is_told_that_squares_are_counted(text):
    with pytest.raises(ValueError, match="squares, not inner corners") as caught:
        parse_squares(text)
    assert "pixels" not in str(caught.value)


@pytest.mark.parametrize("text", ["2x7", "0x0", "10x201", "999999x5"])
def test_boards_out_of_range_are_told_the_range(text):
    with pytest.raises(ValueError, match="3 to 200 squares along each side"):
        parse_squares(text)


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "0", "-1", "1e300", "1e-300", "abc", ""])
@pytest.mark.parametrize("command", ["camera", "watch"])
def test_a_square_without_a_usable_size_is_wrong_usage(run, command, value):
    code, _, err = run("calibrate", command, "folder", "--squares", "10x7", f"--square-mm={value}")
    assert code == 2
    assert "square-mm" in err
    assert "bug" not in err


@pytest.mark.parametrize("name", sorted(calibrate.commands))
def test_every_number_of_every_calibration_command_is_bounded(name):
    for option in calibrate.commands[name].params:
        kind = option.type
        assert kind not in (click.FLOAT, click.INT), option.name
        if isinstance(kind, click.FloatRange | click.IntRange):
            assert isinstance(kind, Number | click.IntRange), option.name
            assert kind.min is not None, option.name
            assert kind.max is not None, option.name


@pytest.mark.parametrize("value", ["nan", "inf", "0", "-3", "1,nan", "1,,2"])
def test_exposures_that_are_none_are_wrong_usage(run, value):
    code, _, err = run("calibrate", "response", "--rig", f"--exposures={value}")
    assert code == 2
    assert "positive numbers of ms" in err
