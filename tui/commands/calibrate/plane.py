"""The subcommands that calibrate the light plane: from sweeps over boards, and from two reference planes."""

# ruff: noqa: PLC0415 - imports happen when a command runs, so that --help is quick

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from acquire.contract.errors import CalibrationError
from tui.commands.calibrate.options import EDGES, METHODS, PATH, board_of, force_option, size_option
from tui.commands.context import json_option, print_json

if TYPE_CHECKING:
    from process.calibration.light_plane.from_sweeps import PlaneResult


@click.command()
@click.argument("scans", nargs=-1, type=PATH)
@click.option("--camera", "camera_file", required=True, type=PATH, help="Calibration with the camera.")
@click.option("--squares", metavar="CxR", callback=size_option, help="Squares of the board in SCANS.")
@click.option("--square-mm", type=float, help="Side of a square in mm.")
@click.option("--flat", multiple=True, type=PATH, help="Sweep over a matt white flat of any height; may be repeated.")
@click.option("--method", type=METHODS, default="auto", show_default=True, help="Crossing estimate.")
@click.option("--edge", type=EDGES, default="rising", show_default=True)
@click.option("--contrast", type=click.IntRange(0, 255), help="Least brightness range used, counts of 8 bit [70].")
@click.option("--days", type=float, default=30.0, show_default=True, help="How long it is meant to be used.")
@click.option("--out", type=PATH, default=Path("calibration.json"), show_default=True)
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
    and corners together tell the poses, and say how well points will be known. A surface that contradicts the others
    by more than 1 um fails; --force writes the calibration all the same."""
    from process.calibration.calibration_file import read_document, write_document
    from process.calibration.light_plane.recipe import SweepRecipe, make_plane, with_plane
    from process.calibration.report_page import plane_page, write_page

    if not scans or squares is None or square_mm is None:
        raise CalibrationError("name sweeps over the board, with --squares and --square-mm: flats alone cannot do")
    board = board_of(squares, square_mm)
    recipe = SweepRecipe(
        _absolute(scans), board.columns, board.rows, square_mm, _absolute(flat), edge, contrast,  # type: ignore[arg-type]
    )  # fmt: skip
    document = read_document(camera_file)
    result = make_plane(recipe, document, method)
    if not as_json:
        click.echo("\n".join(plane_words(result)))
    if not result.ok and not force:
        bad = next(surface for surface in result.surfaces if not surface.ok)
        raise CalibrationError(f"failed, nothing was written: {bad.name}: {bad.cause} (--force writes it all the same)")
    document = with_plane(document, result, recipe, days)
    write_document(out, document, force=force or out == camera_file)
    page = out.with_name(f"{out.stem}-plane.html")
    write_page(page, plane_page(result, plane_words(result)))
    if as_json:
        print_json({"out": out, "report": page, "light_plane": document["light_plane"]})
    else:
        click.echo(f"{out}\n{page}")


def _absolute(paths: tuple[Path, ...]) -> tuple[str, ...]:
    return tuple(str(path.absolute()) for path in paths)


@click.command()
@click.argument("calibration", type=PATH)
@click.option("--method", type=METHODS, required=True, help="Crossing estimate to make it again with.")
@click.option("--out", required=True, type=PATH, help="Where the calibration goes.")
@force_option
@json_option
def refit(calibration: Path, method: str, out: Path, force: bool, as_json: bool) -> None:
    """Make a light plane again from its own stored sweeps, with another estimate of the crossings."""
    from process.calibration.calibration_file import read_document, write_document
    from process.calibration.light_plane.recipe import refit as make_again

    made = make_again(read_document(calibration), method)
    write_document(out, made.document, force=force)
    if as_json:
        print_json({"out": out, "light_plane": made.document["light_plane"]})
        return
    click.echo("\n".join([*plane_words(made.result), str(out)]))


def plane_words(result: PlaneResult) -> list[str]:
    """The result for people, one line each."""
    lines = [
        f"{s.name}: {s.pixels} pixels, mean residual {s.mean_um:+.2f} um, RMS {s.rms_um:.2f} um, "
        f"trend {s.slope_um:.2f} um, bend {s.bend_um:.2f} um, {100 * s.outlier_share:.0f} % left out"
        + ("" if s.height_mm is None else f", height {s.height_mm:.4f} mm")
        + ("" if s.moved is None else f", {s.moved.um:.2f} um from where its corners alone put it")
        + (f": {s.cause}" if s.cause else "")
        for s in result.surfaces
    ]
    n = result.normal
    unit = "um of travel" if result.parameter == "position_um" else "frame"
    lines.append(
        f"normal ({n[0]:.5f}, {n[1]:.5f}, {n[2]:.5f}) +- {result.normal_sd_deg:.4f} degrees, "
        f"{1000 * result.speed_mm:.5f} um along it per {unit} +- {100 * result.speed_sd:.4f} %"
    )
    parts = ", ".join(f"{name} {value:.4f}" for name, value in result.normal_sd_parts_deg.items())
    lines.append(f"the normal's standard deviation by source, degrees: {parts}")
    lines.append(
        f"predicted error of a point at the corners of the field: {result.predicted_um[0]:.2g} um on the stage, "
        f"{result.predicted_um[1]:.2g} um half a millimetre above (standard deviations, all together)"
    )
    lines.append("commanded speed: not determinable, sweeps show the motion along the normal only")
    return lines + [f"note: {note}" for note in result.notes]


@click.command("reference-planes")
@click.argument("scan", type=PATH)
@click.option("--camera", "camera_file", required=True, type=PATH, help="Calibration with the camera.")
@click.option("--planes", "planes_file", required=True, type=PATH, help="JSON with reference_planes.")
@click.option("--method", type=METHODS, default="auto", show_default=True, help="Crossing estimate.")
@click.option("--edge", type=EDGES, default="rising", show_default=True)
@click.option("--contrast", type=click.IntRange(0, 255), default=50, show_default=True)
@click.option("--out", type=PATH, default=Path("calibration.json"), show_default=True)
@force_option
@json_option
def reference_planes_command(
    scan: Path,
    camera_file: Path,
    planes_file: Path,
    method: str,
    edge: str,
    contrast: int,
    out: Path,
    force: bool,
    as_json: bool,
) -> None:
    """One light plane per frame, from the edge on two known planes (hand-swept rigs).

    The planes' file holds {"reference_planes": {"marker_rectangle_mm": [w, h], NAME: {"marker_corners_px": 4 x [x, y],
    "image_region_px": [left, right, top, bottom]}, NAME: ...}}."""
    from acquire.contract.calibration import check_size, load_calibration
    from process.calibration.calibration_file import read_document, write_document
    from process.calibration.light_plane.sweeps import fold_sweep
    from process.calibration.light_plane.uncertainty import camera_covariance
    from process.calibration.reference_planes.calibrate import fit_reference_planes, read_planes
    from process.calibration.reference_planes.uncertainty import camera_sd

    found = load_calibration(camera_file)[0]
    known = read_planes(planes_file, found.camera)
    sweep = fold_sweep(scan, method=method, edge=edge, contrast=contrast, clean=False)  # type: ignore[arg-type]
    check_size(found, sweep.format.width, sweep.format.height)
    result = fit_reference_planes(sweep.crossing, known, found.camera, edge=edge, method=method)
    document = read_document(camera_file)
    covariance = camera_covariance(document)
    if covariance is not None:
        spread = camera_sd(
            sweep.crossing, lambda camera: read_planes(planes_file, camera), found.camera, covariance,
            edge=edge, method=method, frames=len(result.planes),
        )  # fmt: skip
        result = replace(result, camera_sd=spread)
    document["light_plane"] = result.document()
    write_document(out, document, force=force)
    skew = sorted(result.skew_mm.tolist())
    words = (
        f"planes for frames {result.planes[0].t} to {result.planes[-1].t} (1-based); the two lines of a frame miss "
        f"each other by {skew[len(skew) // 2]:.2f} mm (median), {skew[-1]:.2f} mm at most"
    )
    if result.camera_sd is not None:
        words += (
            f"\nthe camera's uncertainty alone moves them by {result.camera_sd[0]:.2f} mm at the middle of the scene "
            f"and turns them by {result.camera_sd[1]:.3f} degrees (standard deviations)"
        )
    print_json({"out": out, "light_plane": document["light_plane"]}) if as_json else click.echo(f"{words}\n{out}")
