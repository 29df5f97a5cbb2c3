"""The subcommand that converts files of the original program."""

from __future__ import annotations

from pathlib import Path

import click

from tui.commands.calibrate.shared import out_option
from tui.commands.context import PATH, force_option, json_option, print_json, size_callback


@click.command("import-original")
@click.argument("calibration_txt", metavar="CALIBRATION.TXT", type=PATH)
@click.option("--projector", type=PATH, help="projector.txt of the sequence; without it: the camera only.")
@click.option("--size", default="1024x768", show_default=True, callback=size_callback, help="Size of the pictures.")
@out_option
@force_option
@json_option
def import_original(
    calibration_txt: Path, projector: Path | None, size: tuple[int, int], out: Path, force: bool, as_json: bool
) -> None:
    """Convert files of the original program to calibration.json.

    Points come out the same."""
    from process.calibration.calibration_file import new_document, write_document
    from process.calibration.original_program import light_plane, read_calibration_txt, read_projector_txt

    original = read_calibration_txt(calibration_txt)
    plane_fields = None if projector is None else light_plane(original, read_projector_txt(projector))
    document = new_document(original.camera(*size), plane_fields)
    write_document(out, document, force=force)
    if as_json:
        print_json({"out": out, **document})
        return
    click.echo(f"{out}" if plane_fields else f"{out}: camera only; name projector.txt with --projector for the plane")
