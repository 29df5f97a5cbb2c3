"""The subcommand that calibrates the camera from pictures of a board."""

# ruff: noqa: PLC0415 - imports happen when a command runs, so that --help is quick

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from acquire.contract.errors import CalibrationError
from tui.commands.calibrate.options import PATH, board_of, force_option, size_option
from tui.commands.context import json_option, print_json

if TYPE_CHECKING:
    from process.calibration.camera.calibrate import CameraResult

SUFFIXES = (".png", ".bmp", ".jpg", ".jpeg", ".tif", ".tiff")


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


@click.command()
@click.argument("images", nargs=-1, required=True, type=PATH)
@click.option("--squares", required=True, metavar="CxR", callback=size_option, help="Squares (or dots) of the board.")
@click.option("--square-mm", required=True, type=float, help="Side of a square, or distance of two dots, in mm.")
@click.option("--kind", type=click.Choice(["chessboard", "charuco", "dots"]), default="chessboard", show_default=True)
@click.option(
    "--corners",
    type=click.Choice(["auto", "saddle", "sector", "gradient"]),
    default="auto",
    show_default=True,
    help="Estimate of a chessboard's corners.",
)
@click.option("--stage", metavar="VIEW", help="Name of the picture with the board lying flat: it makes z = 0.")
@click.option("--out", type=PATH, default=Path("calibration.json"), show_default=True)
@force_option
@json_option
def camera(
    images: tuple[Path, ...],
    squares: tuple[int, int],
    square_mm: float,
    kind: str,
    corners: str,
    stage: str | None,
    out: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Calibrate the camera from pictures of a board in different tilts.

    IMAGES are files or folders. Views that hurt are left out, with the reason."""
    from process.calibration.calibration_file import new_document, write_document
    from process.calibration.camera.calibrate import calibrate_camera
    from process.calibration.report_page import camera_page, write_page

    name = Path(stage).name if stage else None
    result = calibrate_camera(read_pictures(images), board_of(squares, square_mm, kind), name, corners)
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
