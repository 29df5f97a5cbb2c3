"""The subcommands that check a calibration with a sweep, and shift its light plane after homing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from acquire.contract.errors import CalibrationError
from tui.commands.calibrate.shared import LENGTH_MM, board_of, squares_callback
from tui.commands.context import PATH, Number, Session, force_option, json_option, print_json

if TYPE_CHECKING:
    from acquire.contract.calibration import Calibration, TranslatingPlane
    from acquire.contract.config.model import CheckConfig
    from process.calibration.check.planarity import CheckResult, Repeatability
    from process.calibration.check.spheres import Sphere
    from process.calibration.light_plane.sweeps import FoldedSweep


def _checked(
    scan: Path, calibration_file: Path, squares: tuple[int, int] | None, square_mm: float | None
) -> CheckResult:
    """Compare a sweep over the board, or over a flat if no board is described, with a calibration."""
    from process.calibration.check.planarity import check_surface
    from process.calibration.light_plane.surfaces import board_surface, flat_surface

    sweep, found, plane = _folded(scan, calibration_file)
    if squares is None or square_mm is None:
        return check_surface(flat_surface(sweep), found.camera, plane)
    return check_surface(board_surface(sweep, board_of(squares, square_mm), found.camera), found.camera, plane)


def _folded(scan: Path, calibration_file: Path) -> tuple[FoldedSweep, Calibration, TranslatingPlane]:
    """A sweep, folded as the calibration's own sweeps were; the calibration; its light plane."""
    from acquire.contract.calibration import TranslatingPlane, check_size, load_calibration
    from process.calibration.light_plane.sweeps import fold_sweep

    found = load_calibration(calibration_file)[0]
    plane = found.light_plane
    if not isinstance(plane, TranslatingPlane):
        raise CalibrationError(f"{calibration_file} has no light plane that translates: nothing to check")
    sweep = fold_sweep(scan, method=plane.method, edge=plane.edge)
    check_size(found, sweep.format.width, sweep.format.height)
    return sweep, found, plane


@click.command()
@click.argument("scan", type=PATH)
@click.option("--calibration", "calibration_file", required=True, type=PATH, help="The calibration to check.")
@click.option(
    "--squares", metavar="CxR", callback=squares_callback, help="Squares of the board in SCAN; without: a flat."
)
@click.option("--square-mm", type=LENGTH_MM, help="Side of a square in mm.")
@click.option("--again", type=PATH, help="A second sweep over the same object: repeatability.")
@click.option("--sphere-mm", type=LENGTH_MM, multiple=True, help="Diameter of a sphere in SCAN; once or twice.")
@click.option("--spacing-mm", type=LENGTH_MM, help="Known distance of two spheres.")
@click.option("--limit-um", type=Number(1e-3, 1e6), help="Limit of all figures in um, instead of rig.toml's [check].")
@json_option
@click.pass_obj
def check(
    session: Session,
    scan: Path,
    calibration_file: Path,
    squares: tuple[int, int] | None,
    square_mm: float | None,
    again: Path | None,
    sphere_mm: tuple[float, ...],
    spacing_mm: float | None,
    limit_um: float | None,
    as_json: bool,
) -> int:
    """Check a calibration with a sweep over the board, a flat, or one or two spheres.

    Board and flat: flatness, and with the board offset and scale. Spheres: probing errors and sphere-spacing error
    (VDI/VDE 2634 part 2). Passed or failed against [check] in rig.toml."""
    from process.calibration.check.verdict import repeatability_figures, sphere_figures, surface_figures

    limits = _limits(session, limit_um)
    if sphere_mm:
        sweep, found, plane = _folded(scan, calibration_file)
        words, figures = _spheres(sweep, found, plane)
        verdicts = sphere_figures(figures, sphere_mm, spacing_mm, limits)
    else:
        result = _checked(scan, calibration_file, squares, square_mm)
        words, verdicts = result.lines(), surface_figures(result, limits)
    if again is not None:
        repeated = _repeated(scan, again, calibration_file)
        words += repeated.lines()
        verdicts += repeatability_figures(repeated, limits)
    passed = all(figure.ok for figure in verdicts)
    if as_json:
        print_json({"passed": passed, "figures": verdicts})
    else:
        lines = [*words, *(figure.text() for figure in verdicts), "passed" if passed else "FAILED"]
        click.echo("\n".join(lines))
    return 0 if passed else 1


def _limits(session: Session, limit_um: float | None) -> CheckConfig:
    import msgspec

    limits = session.config().rig.check
    if limit_um is None:
        return limits
    names = [name for name in limits.__struct_fields__ if name.endswith("_um")]
    return msgspec.structs.replace(limits, **dict.fromkeys(names, limit_um))


def _spheres(sweep: FoldedSweep, found: Calibration, plane: TranslatingPlane) -> tuple[list[str], list[Sphere]]:
    from process.calibration.check.planarity import cloud_of
    from process.calibration.check.spheres import find_spheres

    spheres = find_spheres(cloud_of(sweep, found.camera, plane))
    words = [
        f"sphere at ({s.centre[0]:.3f}, {s.centre[1]:.3f}, {s.centre[2]:.3f}) mm: diameter {s.diameter_mm:.4f} mm, "
        f"{s.points} points, form {s.form_um:.2f} um, RMS {s.rms_um:.2f} um"
        for s in spheres
    ]
    return words, spheres


def _repeated(scan: Path, again: Path, calibration_file: Path) -> Repeatability:
    from process.calibration.check.planarity import cloud_of, repeatability

    clouds = []
    for which in (scan, again):
        sweep, found, plane = _folded(which, calibration_file)
        clouds.append(cloud_of(sweep, found.camera, plane))
    return repeatability(clouds[0], clouds[1])


@click.command()
@click.argument("scan", type=PATH)
@click.option("--calibration", "calibration_file", required=True, type=PATH, help="The calibration to shift.")
@click.option(
    "--squares", required=True, metavar="CxR", callback=squares_callback, help="Squares of the board in SCAN."
)
@click.option("--square-mm", required=True, type=LENGTH_MM, help="Side of a square in mm.")
@click.option("--out", required=True, type=PATH, help="File for the shifted calibration.")
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
    """Shift a light plane after homing, from one sweep over the board in any pose."""
    from process.calibration.calibration_file import read_document, utc_now, write_document
    from process.calibration.light_plane.recipe import rezeroed

    result = _checked(scan, calibration_file, squares, square_mm)
    document = rezeroed(read_document(calibration_file), result.shift_t)
    document["valid_for"] = {
        **(document.get("valid_for") or {}),
        "created_utc": utc_now(),
        "zero_id": result.zero_id or None,
    }
    write_document(out, document, force=force)
    words = f"the light plane was moved by {result.shift_um:+.2f} um along its normal"
    print_json({"out": out, "shift_um": result.shift_um}) if as_json else click.echo(f"{words}\n{out}")
