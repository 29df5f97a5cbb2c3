"""The subcommands that calibrate the light plane from sweeps over boards, or from two reference planes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from acquire.contract.errors import CalibrationError
from tui.commands.calibrate.shared import (
    LENGTH_MM,
    METHOD,
    board_of,
    camera_option,
    edge_option,
    method_option,
    out_option,
    save,
    squares_callback,
)
from tui.commands.context import (
    PATH,
    Number,
    force_option,
    json_option,
    progress_option,
    progress_printer,
    progress_words,
)

if TYPE_CHECKING:
    pass


@click.command()
@click.argument("scans", nargs=-1, type=PATH)
@camera_option
@click.option("--squares", metavar="CxR", callback=squares_callback, help="Squares of the board in SCANS.")
@click.option("--square-mm", type=LENGTH_MM, help="Side of a square in mm.")
@click.option("--flat", multiple=True, type=PATH, help="Sweep over a matt white flat of any height; may be repeated.")
@method_option
@edge_option
@click.option("--contrast", type=click.IntRange(0, 255), help="Least brightness range used, counts of 8 bit [70].")
@click.option("--days", type=Number(0.01, 36500), default=30.0, show_default=True, help="Validity of the calibration.")
@out_option
@force_option
@json_option
def plane(
    scans: tuple[Path, ...],
    camera_file: Path,
    squares: tuple[int, int] | None,
    square_mm: float | None,
    flat: tuple[Path, ...],
    method: str,
    edge: str,
    contrast: int | None,
    days: float,
    out: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Calibrate the light plane from sweeps over the board, flat and tilted.

    SCANS show the board: once lying flat, and tilted by 10 to 20 degrees both ways (a small board needs both). Light
    and corners together give the poses, and the expected accuracy of points. A surface that disagrees with the others
    by more than 1 um fails the calibration; --force writes it nevertheless."""
    from process.calibration.calibration_file import read_document
    from process.calibration.light_plane.recipe import SweepRecipe, make_plane, with_plane
    from process.calibration.report_page import plane_page

    if not scans or squares is None or square_mm is None:
        raise CalibrationError("name sweeps over the board, with --squares and --square-mm: flats alone do not suffice")
    board = board_of(squares, square_mm)
    recipe = SweepRecipe(
        _absolute(scans), board.columns, board.rows, square_mm, _absolute(flat), edge, contrast,  # type: ignore[arg-type]
    )  # fmt: skip
    document = read_document(camera_file)
    result = make_plane(recipe, document, method)
    lines = result.lines()
    if not as_json:
        click.echo("\n".join(lines))
    if not result.ok and not force:
        bad = next(surface for surface in result.surfaces if not surface.ok)
        raise CalibrationError(f"failed, nothing was written: {bad.name}: {bad.cause} (--force writes it nevertheless)")
    document, page = with_plane(document, result, recipe, days), ("plane", plane_page(result, lines))
    save(out, document, [], force=force or out == camera_file, as_json=as_json, page=page)


def _absolute(paths: tuple[Path, ...]) -> tuple[str, ...]:
    return tuple(str(path.absolute()) for path in paths)


@click.command()
@click.argument("calibration", type=PATH)
@click.option("--method", type=METHOD, required=True, help="Crossing estimate to use.")
@click.option("--out", required=True, type=PATH, help="File for the new calibration.")
@force_option
@json_option
def refit(calibration: Path, method: str, out: Path, force: bool, as_json: bool) -> None:
    """Repeat a light plane calibration with another crossing estimate.

    The sweeps that it was made from must still be there."""
    from process.calibration.calibration_file import read_document
    from process.calibration.light_plane.recipe import refit_plane

    made = refit_plane(read_document(calibration), method)
    save(out, made.document, made.result.lines(), force=force, as_json=as_json)


@click.command("reference-planes")
@click.argument("scan", type=PATH)
@camera_option
@click.option("--planes", "planes_file", required=True, type=PATH, help="JSON with reference_planes.")
@method_option
@click.option(
    "--edge", type=click.Choice(["rising", "falling"]), default="rising", show_default=True,
    help="falling: the front of a shadow; rising: its end, or light that comes.",
)  # fmt: skip
@click.option("--contrast", type=click.IntRange(0, 255), default=50, show_default=True)
@out_option
@force_option
@progress_option
@json_option
def reference_planes(
    scan: Path,
    camera_file: Path,
    planes_file: Path,
    method: str,
    edge: Literal["rising", "falling"],
    contrast: int,
    out: Path,
    force: bool,
    with_progress: bool,
    as_json: bool,
) -> None:
    """One light plane per frame, from the edge on two known planes (hand-swept rigs).

    \b
    The planes' file holds two planes by name:
    {"reference_planes": {"marker_rectangle_mm": [w, h],
      NAME: {"marker_corners_px": 4 x [x, y],
             "image_region_px": [left, right, top, bottom]}, NAME: ...}}

    Corners go around the rectangle, either way; the first two span the width w. A plane may have a marker_rectangle_mm
    of its own. The region shows the edge on this plane, and mostly nothing else. Points are in the world of --camera,
    where z = 0 is its board plane, or in its own coordinates (z away from it) where it has no board: the planes do not
    move it. A picture beside the calibration shows corners, regions and lines: look at it."""
    from process.calibration.calibration_file import read_document
    from process.calibration.reference_planes.picture import draw, write_picture
    from process.calibration.reference_planes.recipe import calibrate_sweep

    if out.exists() and not force:
        raise CalibrationError(f"{out} is there and was left alone: name another file, or replace it with --force")
    result, edges = calibrate_sweep(
        scan, camera_file, planes_file, method=method, edge=edge, contrast=contrast,
        progress=progress_printer(with_progress) if with_progress else progress_words("reading the pictures"),
    )  # fmt: skip
    document = read_document(camera_file) | {"light_plane": result.document()}
    picture = out.with_name("reference-planes.png")
    image = draw(scan, result.known, edges, [plane.t for plane in result.planes if plane.skew_mm is not None])
    save(out, document, result.lines(), force=force, as_json=as_json, picture=picture)
    write_picture(picture, image)
    if not as_json:
        click.echo(str(picture))
