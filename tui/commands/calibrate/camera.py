"""The subcommand that calibrates the camera from pictures of a board."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import click

from acquire.contract.errors import CalibrationError
from tui.commands.calibrate.shared import board_of, out_option, save, views_options
from tui.commands.context import PATH, force_option, json_option

SILENT_S = 2.0
"""Work that takes no longer than this shows no progress."""


class BoardViews(NamedTuple):
    """The pictures of a board that can be used together."""

    pictures: list[tuple[str, Any]]
    """(name, grey levels), in natural order of their names."""
    left_out: list[tuple[str, str]]
    """(name, reason) of the others."""


def read_pictures(images: tuple[Path, ...]) -> BoardViews:
    """The pictures in files and folders. Unreadable ones, and those of another size than most, are left out by name.

    Raises:
        CalibrationError: none is left.
    """
    from acquire.pictures.listing import list_pictures, told
    from acquire.pictures.names import readable
    from acquire.pictures.reader import PictureError, read_grey

    pictures: list[tuple[str, Any]] = []
    left_out: list[tuple[str, str]] = []
    for place in images:
        listing = list_pictures(place) if place.is_dir() else None
        left_out += [(readable(name), why) for name, why in listing.odd.items()] if listing else []
        for file in listing.paths if listing else [place]:
            try:
                pictures.append((readable(file.name), read_grey(file)))
            except PictureError as error:
                left_out.append((readable(file.name), error.why))
    if not pictures:
        raise CalibrationError(f"there is no picture that can be read: {told(left_out)}")
    return _of_one_size(pictures, left_out)


def _of_one_size(pictures: list[tuple[str, Any]], left_out: list[tuple[str, str]]) -> BoardViews:
    from collections import Counter

    (height, width), count = Counter(pixels.shape for _, pixels in pictures).most_common(1)[0]
    others = [
        (name, f"is {pixels.shape[1]} x {pixels.shape[0]}, not {width} x {height} as {count} others")
        for name, pixels in pictures
        if pixels.shape != (height, width)
    ]
    same = [(name, pixels) for name, pixels in pictures if pixels.shape == (height, width)]
    return BoardViews(same, left_out + others)


class SlowProgress:
    """Lines of progress on stderr once the work has taken longer than SILENT_S; those of before are then told too."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now, self._began_s = now, now()
        self._kept: list[str] = []

    def __call__(self, line: str) -> None:
        """Take one line."""
        self._kept.append(line)
        if self._now() - self._began_s > SILENT_S:
            click.echo("\n".join(self._kept), err=True)
            self._kept.clear()


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
    dictionary: str,
    legacy_layout: bool | None,
    corners: str,
    stage: str | None,
    out: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Calibrate the camera from pictures of a board in different tilts.

    IMAGES are files or folders. Views that degrade the fit are left out, with the reason."""
    from acquire.pictures.listing import told
    from process.calibration.calibration_file import new_document
    from process.calibration.camera.calibrate import calibrate_camera
    from process.calibration.report_page import camera_page

    name = Path(stage).name if stage else None
    views = read_pictures(images)
    for odd in views.left_out:
        click.echo(f"left out: {told([odd])}", err=True)
    board = board_of(squares, square_mm, kind, dictionary, legacy_layout)
    result = calibrate_camera(views.pictures, board, name, corners, SlowProgress())
    document, lines = new_document(result.document()), result.lines()
    page = ("camera", camera_page(result, lines))
    left_out = [{"name": name, "reason": why} for name, why in views.left_out]
    save(out, document, lines, force=force, as_json=as_json, section="camera", page=page, left_out=left_out)
