"""The subcommand that makes a board to print."""

from __future__ import annotations

from pathlib import Path

import click

from acquire.contract.errors import CalibrationError
from tui.commands.calibrate.shared import LENGTH_MM, dictionary_callback, squares_callback
from tui.commands.context import PATH, force_option

DEFAULT_SQUARE_MM = {"a4": 20.0, "a3": 30.0, "letter": 20.0}


@click.command()
@click.option("--pdf", required=True, type=PATH, help="File to write.")
@click.option("--paper", type=click.Choice(list(DEFAULT_SQUARE_MM)), default="a4", show_default=True)
@click.option("--kind", type=click.Choice(["chessboard", "charuco", "dots"]), default="charuco", show_default=True)
@click.option("--squares", metavar="CxR", callback=squares_callback, help="Squares (or dots) [as many as fit].")
@click.option("--square-mm", type=LENGTH_MM, help="Side of a square, or distance of dots [20 mm; a3: 30 mm].")
@click.option(
    "--dictionary", default="DICT_5X5", show_default=True, callback=dictionary_callback, help="Of a ChArUco board."
)
@force_option
def board(
    pdf: Path,
    paper: str,
    kind: str,
    squares: tuple[int, int] | None,
    square_mm: float | None,
    dictionary: str,
    force: bool,
) -> None:
    """Make a calibration board to print, in true millimetres.

    It has a scale bar to measure after printing, and the command that calibrates with it."""
    from acquire.contract.files import replace_file
    from process.calibration.board.board_pdf import board_pdf, command, usual_squares
    from process.calibration.board.detection import Board

    side = square_mm or DEFAULT_SQUARE_MM[paper]
    columns, rows = squares or usual_squares(paper, side)
    if min(columns, rows) < 3:
        raise CalibrationError(f"fewer than 3 x 3 squares of {side:g} mm fit on {paper}: give a smaller --square-mm")
    made = Board(max(columns, rows), min(columns, rows), side, kind, dictionary)  # type: ignore[arg-type]
    content = board_pdf(made, paper)
    if pdf.exists() and not force:
        raise CalibrationError(f"{pdf} exists already: give another name, or --force")
    try:
        replace_file(pdf, content)
    except OSError as error:
        raise CalibrationError(f"cannot write {pdf}: {error.strerror}") from None
    click.echo(f"{pdf}\nprint it at 100 % and measure its bar of 100 mm; then\n{command(made)}")
