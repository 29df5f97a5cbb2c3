"""The subcommands that check a calibration with a sweep, and move its plane after homing."""

# ruff: noqa: PLC0415 - imports happen when a command runs, so that --help is quick

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from acquire.contract.errors import CalibrationError
from tui.commands.calibrate.options import PATH, board_of, force_option, size_option
from tui.commands.context import json_option, print_json

if TYPE_CHECKING:
    from process.calibration.check import CheckResult


def _checked(
    scan: Path, calibration_file: Path, squares: tuple[int, int] | None, square_mm: float | None
) -> CheckResult:
    """A sweep over the board, or over a flat where no board is described, against a calibration."""
    from acquire.contract.calibration import TranslatingPlane, load_calibration
    from process.calibration.check import check_surface
    from process.calibration.surfaces import board_surface, flat_surface
    from process.calibration.sweeps import fold_sweep

    found = load_calibration(calibration_file)[0]
    plane_model = found.light_plane
    if not isinstance(plane_model, TranslatingPlane):
        raise CalibrationError(f"{calibration_file} has no light plane that translates: nothing to check")
    sweep = fold_sweep(scan, method=plane_model.method, edge=plane_model.edge)
    if squares is None or square_mm is None:
        return check_surface(flat_surface(sweep), found.camera, plane_model)
    surface = board_surface(sweep, board_of(squares, square_mm, "chessboard"), found.camera)
    return check_surface(surface, found.camera, plane_model)


@click.command()
@click.argument("scan", type=PATH)
@click.option("--calibration", "calibration_file", required=True, type=PATH, help="The calibration to check.")
@click.option("--squares", metavar="CxR", callback=size_option, help="Squares of the board in SCAN; without: a flat.")
@click.option("--square-mm", type=float, help="Side of a square in mm.")
@click.option("--limit-um", type=float, default=5.0, show_default=True, help="Largest flatness error and offset.")
@json_option
def check(
    scan: Path,
    calibration_file: Path,
    squares: tuple[int, int] | None,
    square_mm: float | None,
    limit_um: float,
    as_json: bool,
) -> int:
    """Check a calibration with a sweep over the board or a flat: planarity and offset."""
    result = _checked(scan, calibration_file, squares, square_mm)
    passed = result.passed(limit_um)
    if as_json:
        print_json({"passed": passed, "limit_um": limit_um, "result": result})
    else:
        click.echo("\n".join([*result.words(), f"{'passed' if passed else 'FAILED'} (limit {limit_um:g} um)"]))
    return 0 if passed else 1


@click.command()
@click.argument("scan", type=PATH)
@click.option("--calibration", "calibration_file", required=True, type=PATH, help="The calibration to move.")
@click.option("--squares", required=True, metavar="CxR", callback=size_option, help="Squares of the board in SCAN.")
@click.option("--square-mm", required=True, type=float, help="Side of a square in mm.")
@click.option("--out", required=True, type=PATH, help="Where the moved calibration goes.")
@force_option
@json_option
def rezero(
    scan: Path,
    calibration_file: Path,
    squares: tuple[int, int],
    square_mm: float,
    out: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Move a light plane after homing: one sweep over the board lying anyhow."""
    from process.calibration.documents import read_document, utc_now, write_document
    from process.calibration.recipe import rezeroed

    result = _checked(scan, calibration_file, squares, square_mm)
    document = rezeroed(read_document(calibration_file), result.shift_t)
    document["valid_for"] = {**(document.get("valid_for") or {}), "created_utc": utc_now(), "zero_id": None}
    write_document(out, document, force=force)
    words = f"the light plane was moved by {result.shift_um:+.2f} um along its normal"
    print_json({"out": out, "shift_um": result.shift_um}) if as_json else click.echo(f"{words}\n{out}")
