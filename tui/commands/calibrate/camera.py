"""The subcommand that calibrates the camera from pictures of a board."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from acquire.contract.errors import CalibrationError
from tui.commands.calibrate.shared import PICTURE_SUFFIXES, board_of, out_option, read_grey, save, views_options
from tui.commands.context import PATH, force_option, json_option

if TYPE_CHECKING:
    pass


def read_pictures(images: tuple[Path, ...]) -> list[tuple[str, Any]]:
    """The pictures in files and folders as (name, grey levels), in natural order of their names.

    Raises:
        CalibrationError: no picture, or one that cannot be read.
    """
    from natsort import natsorted

    files: list[Path] = []
    for place in images:
        if place.is_dir():
            files += natsorted(entry for entry in place.iterdir() if entry.suffix.lower() in PICTURE_SUFFIXES)
        else:
            files.append(place)
    pictures = []
    for file in files:
        pixels = read_grey(file)
        if pixels is None:
            raise CalibrationError(f"{file} is no picture that can be read: leave it out")
        pictures.append((file.name, pixels))
    if not pictures:
        raise CalibrationError("no pictures there: name files, or a folder of png, bmp, jpg or tif")
    return pictures


@click.command()
@click.argument("images", nargs=-1, required=True, type=PATH)
@views_options
@click.option(
    "--corners",
    type=click.Choice(["auto", "saddle", "sector", "gradient"]),
    default="auto",
    show_default=True,
    help="Method that locates a chessboard's corners.",
)
@click.option("--stage", metavar="VIEW", help="Name of the picture with the board lying flat: it defines z = 0.")
@out_option
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

    IMAGES are files or folders. Views that degrade the fit are left out, with the reason."""
    from process.calibration.calibration_file import new_document
    from process.calibration.camera.calibrate import calibrate_camera
    from process.calibration.report_page import camera_page

    name = Path(stage).name if stage else None
    result = calibrate_camera(read_pictures(images), board_of(squares, square_mm, kind), name, corners)
    document, lines = new_document(result.document()), result.lines()
    page = ("camera", camera_page(result, lines))
    save(out, document, lines, force=force, as_json=as_json, section="camera", page=page)
