"""Options that several calibration commands share, and how they read pictures and save results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from acquire.contract.errors import CalibrationError
from tui.commands.context import PATH, Number, options, print_json

if TYPE_CHECKING:
    from process.calibration.board.detection import Board

LENGTH_MM = Number(1e-4, 1e4)
"""Sizes of boards and lenses in mm, from a tenth of a micrometre to ten metres."""
METHOD = click.Choice(["linear", "probit", "fit", "auto"])
method_option = click.option("--method", type=METHOD, default="auto", show_default=True, help="Crossing estimate.")
edge_option = click.option("--edge", type=click.Choice(["rising", "falling"]), default="rising", show_default=True)
camera_option = click.option(
    "--camera", "camera_file", required=True, type=PATH, help="Calibration file with the camera."
)
out_option = click.option("--out", type=PATH, default=Path("calibration.json"), show_default=True)


def squares_callback(_context: click.Context, _parameter: click.Parameter, value: str | None) -> tuple[int, int] | None:
    """Click callback of ``--squares``: squares along both sides; None without a value."""
    from tui.text.sizes import parse_squares

    try:
        return None if value is None else parse_squares(value)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


def dictionary_callback(_context: click.Context, _parameter: click.Parameter, value: str | None) -> str:
    """Click callback of ``--dictionary``; empty without a value."""
    from process.calibration.board.charuco import dictionary_named

    try:
        return dictionary_named(value) if value else ""
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


views_options = options(
    click.option(
        "--squares",
        required=True,
        metavar="CxR",
        callback=squares_callback,
        help="Squares of the board along both sides, not inner corners; of dots the dots.",
    ),
    click.option(
        "--square-mm", required=True, type=LENGTH_MM, help="Side of a square, or distance of two dots, in mm."
    ),
    click.option(
        "--kind", type=click.Choice(["chessboard", "charuco", "dots"]), default="chessboard", show_default=True
    ),
    click.option(
        "--dictionary",
        metavar="NAME",
        callback=dictionary_callback,
        help="ChArUco: dictionary of the markers, such as DICT_5X5_250 [found by trying].",
    ),
    click.option(
        "--legacy-layout/--new-layout",
        "legacy_layout",
        default=None,
        help="ChArUco: layout before OpenCV 4.6, or since [found by trying].",
    ),
)
"""The board in pictures of the camera."""


def board_of(
    squares: tuple[int, int],
    pitch_mm: float,
    kind: str = "chessboard",
    dictionary: str = "",
    legacy_layout: bool | None = None,
) -> Board:
    """The board that --squares, --square-mm, --kind, --dictionary and --legacy-layout describe.

    Raises:
        CalibrationError: too few squares, no size, or markers of a board that has none.
    """
    from process.calibration.board.detection import Board

    if min(squares) < 3 or pitch_mm <= 0:
        raise CalibrationError("a board has at least 3 x 3 squares of a positive size: see --squares, --square-mm")
    if kind != "charuco" and (dictionary or legacy_layout is not None):
        raise CalibrationError(f"a {kind} has no markers: --dictionary and the layouts belong to --kind charuco")
    return Board(max(squares), min(squares), pitch_mm, kind, dictionary, legacy_layout)  # type: ignore[arg-type]


def save(
    out: Path,
    document: dict[str, Any],
    lines: Sequence[str],
    *,
    force: bool,
    as_json: bool,
    section: str = "light_plane",
    page: tuple[str, str] | None = None,
    **more: Any,
) -> None:
    """Write a calibration and its report page, and print the result.

    Args:
        out: calibration.json to write.
        document: its content.
        lines: the result as text.
        force: replace an existing file.
        as_json: print one JSON object instead of text.
        section: the part of the document that is new.
        page: suffix of the report's file name, and its HTML.
        more: further keys of the JSON object.

    Raises:
        CalibrationError: the file exists already, or cannot be written.
    """
    from process.calibration.calibration_file import write_document

    write_document(out, document, force=force)
    facts: dict[str, Any] = {"out": out}
    if page is not None:
        from process.calibration.report_page import write_page

        facts["report"] = out.with_name(f"{out.stem}-{page[0]}.html")
        write_page(facts["report"], page[1])
    if as_json:
        print_json({**facts, section: document[section], **more})
    else:
        click.echo("\n".join([*lines, *map(str, facts.values())]))
