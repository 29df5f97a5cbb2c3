"""Subcommands of calibration: camera, light plane, checks, rezero, files of the original program."""

# ruff: noqa: PLC0415 - imports happen when a command runs, so that --help is quick

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from acquire.contract.errors import CalibrationError
from tui.commands.context import json_option, print_json

if TYPE_CHECKING:
    from process.calibration.boards import Board
    from process.calibration.camera import CameraResult
    from process.calibration.check import CheckResult
    from process.calibration.plane_sweep import PlaneResult

_path = click.Path(path_type=Path)
_force = click.option("--force", is_flag=True, help="Replace an existing file.")
SUFFIXES = (".png", ".bmp", ".jpg", ".jpeg", ".tif", ".tiff")


@click.group()
def calibrate() -> None:
    """Calibrate camera and light plane, and check what they are worth."""


def _size(_context: click.Context, _parameter: click.Parameter, value: str | None) -> tuple[int, int] | None:
    from tui.sizes import parse_size

    if value is None:
        return None
    try:
        return parse_size(value)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


def _board(squares: tuple[int, int], pitch_mm: float, kind: str) -> Board:
    from process.calibration.boards import Board

    if min(squares) < 3 or pitch_mm <= 0:
        raise CalibrationError("a board has at least 3 x 3 squares of a positive size: see --squares, --square-mm")
    return Board(max(squares), min(squares), pitch_mm, kind)  # type: ignore[arg-type]


def read_pictures(images: tuple[Path, ...]) -> list[tuple[str, Any]]:
    """Named pictures (grey or RGB) of files and folders, in natural order.

    Raises:
        CalibrationError: no picture, or one that cannot be read.
    """
    import cv2
    from natsort import natsorted

    files: list[Path] = []
    for place in images:
        if place.is_dir():
            files += natsorted(entry for entry in place.iterdir() if entry.suffix.lower() in SUFFIXES)
        else:
            files.append(place)
    pictures = []
    for file in files:
        pixels = cv2.imread(str(file), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
        if pixels is None:
            raise CalibrationError(f"{file} is no picture that can be read: leave it out")
        pictures.append((file.name, pixels))
    if not pictures:
        raise CalibrationError("no pictures there: name files, or a folder of png, bmp, jpg or tif")
    return pictures


@calibrate.command()
@click.argument("images", nargs=-1, required=True, type=_path)
@click.option("--squares", required=True, metavar="CxR", callback=_size, help="Squares (or dots) of the board.")
@click.option("--square-mm", required=True, type=float, help="Side of a square, or distance of two dots, in mm.")
@click.option("--kind", type=click.Choice(["chessboard", "charuco", "dots"]), default="chessboard", show_default=True)
@click.option("--stage", metavar="VIEW", help="Name of the picture with the board lying flat: it makes z = 0.")
@click.option("--out", type=_path, default=Path("calibration.json"), show_default=True)
@_force
@json_option
def camera(
    images: tuple[Path, ...],
    squares: tuple[int, int],
    square_mm: float,
    kind: str,
    stage: str | None,
    out: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Calibrate the camera from pictures of a board in different tilts.

    IMAGES are files or folders. Views that hurt are left out, with the reason."""
    from process.calibration.camera import calibrate_camera
    from process.calibration.documents import new_document, write_document
    from process.calibration.pages import camera_page, write_page

    name = Path(stage).name if stage else None
    result = calibrate_camera(read_pictures(images), _board(squares, square_mm, kind), name)
    document = new_document(result.document())
    write_document(out, document, force=force)
    page = out.with_name(f"{out.stem}-camera.html")
    write_page(page, camera_page(result, camera_words(result)))
    if as_json:
        print_json({"out": out, "report": page, "camera": document["camera"]})
        return
    click.echo("\n".join([*camera_words(result), str(out), str(page)]))


def camera_words(result: CameraResult) -> list[str]:
    """The result for people, one line each."""
    fit, sd = result.fit, result.sd
    fx, fy, cx, cy = fit.intrinsics[:4]
    terms = ", ".join(
        f"{name} = {value:.4g} +- {sd[name]:.2g}"
        for name, value in zip(("k1", "k2", "p1", "p2", "k3"), fit.distortion, strict=True)
        if sd[name] > 0
    )
    lines = [f"left out {view.name}: {view.reason}" for view in result.views if view.reason]
    lines += [
        f"{len(result.used)} of {len(result.views)} views, reprojection error {fit.rms_px:.4f} px RMS "
        f"(corners by the {result.corner_estimate} estimate)",
        f"fx = {fx:.2f} +- {sd['fx']:.2f}, fy = {fy:.2f} +- {sd['fy']:.2f}, "
        f"cx = {cx:.2f} +- {sd['cx']:.2f}, cy = {cy:.2f} +- {sd['cy']:.2f} px",
        f"distortion: {terms or 'none'} (chosen by held-out views: "
        + ", ".join(f"{model} {error:.4f}" for model, error in result.held_out_px.items())
        + " px)",
    ]
    if result.stage is None:
        lines.append("note: no --stage view: the world is the camera's own frame")
    return lines + [f"note: {note}" for note in result.notes]


@calibrate.command()
@click.argument("scans", nargs=-1, type=_path)
@click.option("--camera", "camera_file", required=True, type=_path, help="Calibration with the camera.")
@click.option("--squares", metavar="CxR", callback=_size, help="Squares of the board in SCANS.")
@click.option("--square-mm", type=float, help="Side of a square in mm.")
@click.option("--flat", multiple=True, type=_path, help="Sweep over a matt white flat of any height; may be repeated.")
@click.option("--method", default="linear", show_default=True, help="Crossing estimate.")
@click.option("--edge", type=click.Choice(["rising", "falling"]), default="rising", show_default=True)
@click.option("--contrast", type=click.IntRange(0, 255), help="Least brightness range used, counts of 8 bit [70].")
@click.option("--days", type=float, default=30.0, show_default=True, help="How long it is meant to be used.")
@click.option("--out", type=_path, default=Path("calibration.json"), show_default=True)
@_force
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

    SCANS show the board in poses that its own corners tell. A surface that contradicts the others by more than
    1 um fails; --force writes the calibration all the same."""
    from acquire.contract.calibration import load_calibration
    from process.calibration.documents import read_document, write_document
    from process.calibration.pages import plane_page, write_page
    from process.calibration.plane_sweep import board_surface, fit_plane, flat_surface
    from process.calibration.sweeps import fold_sweep

    if not scans or squares is None or square_mm is None:
        raise CalibrationError("name sweeps over the board, with --squares and --square-mm: flats alone cannot do")
    model = load_calibration(camera_file)[0].camera
    board = _board(squares, square_mm, "chessboard")
    fold = {"method": method, "edge": edge, "contrast": contrast}
    surfaces = [board_surface(fold_sweep(scan, **fold), board, model) for scan in scans]  # type: ignore[arg-type]
    surfaces += [flat_surface(fold_sweep(scan, **fold)) for scan in flat]  # type: ignore[arg-type]
    result = fit_plane(surfaces, model, edge=edge, method=method)
    document = read_document(camera_file)
    document["light_plane"] = result.document()
    document["valid_for"] = result.validity(days)
    page = out.with_name(f"{out.stem}-plane.html")
    write_page(page, plane_page(result, plane_words(result)))
    if not as_json:
        click.echo("\n".join([*plane_words(result), str(page)]))
    if not result.ok and not force:
        bad = next(surface for surface in result.surfaces if not surface.ok)
        raise CalibrationError(f"failed, nothing was written: {bad.name}: {bad.cause} (--force writes it all the same)")
    write_document(out, document, force=force or out == camera_file)
    print_json({"out": out, "light_plane": document["light_plane"]}) if as_json else click.echo(str(out))


def plane_words(result: PlaneResult) -> list[str]:
    """The result for people, one line each."""
    lines = [
        f"{s.name}: {s.pixels} pixels, mean residual {s.mean_um:+.2f} um, RMS {s.rms_um:.2f} um, "
        f"trend {s.slope_um:.2f} um, bend {s.bend_um:.2f} um, {100 * s.outlier_share:.0f} % left out"
        + ("" if s.height_mm is None else f", height {s.height_mm:.4f} mm")
        + (f": {s.cause}" if s.cause else "")
        for s in result.surfaces
    ]
    n = result.normal
    unit = "um of travel" if result.parameter == "position_um" else "frame"
    lines.append(
        f"normal ({n[0]:.5f}, {n[1]:.5f}, {n[2]:.5f}) +- {result.normal_sd_deg:.4f} degrees, "
        f"{1000 * result.speed_mm:.5f} um along it per {unit} +- {100 * result.speed_sd:.4f} %"
    )
    lines.append("commanded speed: not determinable, sweeps show the motion along the normal only")
    return lines + [f"note: {note}" for note in result.notes]


@calibrate.command("reference-planes")
@click.argument("scan", type=_path)
@click.option("--camera", "camera_file", required=True, type=_path, help="Calibration with the camera.")
@click.option("--planes", "planes_file", required=True, type=_path, help="JSON with reference_planes.")
@click.option("--method", default="linear", show_default=True, help="Crossing estimate.")
@click.option("--edge", type=click.Choice(["rising", "falling"]), default="rising", show_default=True)
@click.option("--contrast", type=click.IntRange(0, 255), default=50, show_default=True)
@click.option("--out", type=_path, default=Path("calibration.json"), show_default=True)
@_force
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
    from process.calibration.documents import read_document, write_document
    from process.calibration.reference_planes import fit_reference_planes, read_planes
    from process.calibration.sweeps import fold_sweep

    found = load_calibration(camera_file)[0]
    known = read_planes(planes_file, found.camera)
    sweep = fold_sweep(scan, method=method, edge=edge, contrast=contrast, clean=False)  # type: ignore[arg-type]
    check_size(found, sweep.format.width, sweep.format.height)
    result = fit_reference_planes(sweep.crossing, known, found.camera, edge=edge, method=method)
    document = read_document(camera_file)
    document["light_plane"] = result.document()
    write_document(out, document, force=force)
    skew = sorted(result.skew_mm.tolist())
    words = (
        f"planes for frames {result.planes[0].t} to {result.planes[-1].t} (1-based); the two lines of a frame miss "
        f"each other by {skew[len(skew) // 2]:.2f} mm (median), {skew[-1]:.2f} mm at most"
    )
    print_json({"out": out, "light_plane": document["light_plane"]}) if as_json else click.echo(f"{words}\n{out}")


def _checked(
    scan: Path, calibration_file: Path, squares: tuple[int, int] | None, square_mm: float | None
) -> CheckResult:
    """A sweep over the board, or over a flat where no board is described, against a calibration."""
    from acquire.contract.calibration import TranslatingPlane, load_calibration
    from process.calibration.check import check_surface
    from process.calibration.plane_sweep import board_surface, flat_surface
    from process.calibration.sweeps import fold_sweep

    found = load_calibration(calibration_file)[0]
    plane_model = found.light_plane
    if not isinstance(plane_model, TranslatingPlane):
        raise CalibrationError(f"{calibration_file} has no light plane that translates: nothing to check")
    sweep = fold_sweep(scan, method=plane_model.method, edge=plane_model.edge)
    if squares is None or square_mm is None:
        return check_surface(flat_surface(sweep), found.camera, plane_model)
    surface = board_surface(sweep, _board(squares, square_mm, "chessboard"), found.camera)
    return check_surface(surface, found.camera, plane_model)


@calibrate.command()
@click.argument("scan", type=_path)
@click.option("--calibration", "calibration_file", required=True, type=_path, help="The calibration to check.")
@click.option("--squares", metavar="CxR", callback=_size, help="Squares of the board in SCAN; without: a flat.")
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


@calibrate.command()
@click.argument("scan", type=_path)
@click.option("--calibration", "calibration_file", required=True, type=_path, help="The calibration to move.")
@click.option("--squares", required=True, metavar="CxR", callback=_size, help="Squares of the board in SCAN.")
@click.option("--square-mm", required=True, type=float, help="Side of a square in mm.")
@click.option("--out", required=True, type=_path, help="Where the moved calibration goes.")
@_force
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
    from process.calibration.check import rezeroed
    from process.calibration.documents import read_document, utc_now, write_document

    result = _checked(scan, calibration_file, squares, square_mm)
    document = rezeroed(read_document(calibration_file), result.shift_t)
    document["valid_for"] = {**(document.get("valid_for") or {}), "created_utc": utc_now(), "zero_id": None}
    write_document(out, document, force=force)
    words = f"the light plane was moved by {result.shift_um:+.2f} um along its normal"
    print_json({"out": out, "shift_um": result.shift_um}) if as_json else click.echo(f"{words}\n{out}")


@calibrate.command("import-original")
@click.argument("calibration_txt", metavar="CALIBRATION.TXT", type=_path)
@click.option("--projector", type=_path, help="projector.txt of the sequence; without it: the camera only.")
@click.option("--size", default="1024x768", show_default=True, callback=_size, help="Size of the pictures.")
@click.option("--out", type=_path, default=Path("calibration.json"), show_default=True)
@_force
@json_option
def import_original(
    calibration_txt: Path, projector: Path | None, size: tuple[int, int], out: Path, force: bool, as_json: bool
) -> None:
    """Convert files of the original program to calibration.json; points come out the same."""
    from process.calibration.documents import new_document, write_document
    from process.calibration.original import light_plane, read_calibration_txt, read_projector_txt

    original = read_calibration_txt(calibration_txt)
    plane_fields = None if projector is None else light_plane(original, read_projector_txt(projector))
    document = new_document(original.camera(*size), plane_fields)
    write_document(out, document, force=force)
    if as_json:
        print_json({"out": out, **document})
        return
    click.echo(f"{out}" if plane_fields else f"{out}: camera only; name projector.txt with --projector for the plane")


COMMANDS: tuple[click.Command, ...] = (calibrate,)
