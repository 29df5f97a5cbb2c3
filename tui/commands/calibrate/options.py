"""Options that several subcommands of calibration share, and what they become."""

# ruff: noqa: PLC0415 - imports happen when a command runs, so that --help is quick

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from acquire.contract.errors import CalibrationError

if TYPE_CHECKING:
    from process.calibration.board.detection import Board

PATH = click.Path(path_type=Path)
METHODS = click.Choice(["linear", "probit", "fit", "auto"])
EDGES = click.Choice(["rising", "falling"])
force_option = click.option("--force", is_flag=True, help="Replace an existing file.")


def size_option(_context: click.Context, _parameter: click.Parameter, value: str | None) -> tuple[int, int] | None:
    """``CxR`` as two numbers; a callback of click."""
    from tui.text.sizes import parse_size

    if value is None:
        return None
    try:
        return parse_size(value)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


def board_of(squares: tuple[int, int], pitch_mm: float, kind: str = "chessboard") -> Board:
    """The board that --squares, --square-mm and --kind describe.

    Raises:
        CalibrationError: too few squares, or no size.
    """
    from process.calibration.board.detection import Board

    if min(squares) < 3 or pitch_mm <= 0:
        raise CalibrationError("a board has at least 3 x 3 squares of a positive size: see --squares, --square-mm")
    return Board(max(squares), min(squares), pitch_mm, kind)  # type: ignore[arg-type]
