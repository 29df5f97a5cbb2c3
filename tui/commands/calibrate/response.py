"""The subcommand that measures the response of the camera to light, from a series of exposures."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click

from acquire.contract.errors import CalibrationError
from tui.commands.context import PATH, Number, Session, json_option, print_json

TABLE = "exposures.csv"
_IN_NAME = re.compile(r"(\d+(?:[.,]\d+)?)\s*ms", re.IGNORECASE)
MOST_MS = 60_000.0
"""Longest exposure."""
DEFAULT_SHARES = (0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0)
"""Of the configured exposure, with --rig."""


@click.command()
@click.argument("folder", type=PATH, required=False)
@click.option("--rig", "from_rig", is_flag=True, help="Take the series with the rig's camera (the daemon stopped).")
@click.option("--exposures", metavar="MS,MS,...", help="With --rig: in ms [10 to 100 % of camera.exposure_ms].")
@click.option(
    "--width-um", type=Number(1e-3, 1e6), default=38.1, show_default=True, help="Width of a light edge, um of travel."
)
@json_option
@click.pass_obj
def response(
    session: Session, folder: Path | None, from_rig: bool, exposures: str | None, width_um: float, as_json: bool
) -> int:
    """Check that the camera is linear, with pictures of one scene at several exposures.

    FOLDER holds them, with the exposure in each name ("white-12.5ms.png") or in exposures.csv (name,ms)."""
    from process.calibration.camera.response import find_response

    if from_rig == (folder is not None):
        raise click.UsageError("name a folder of pictures, or --rig")
    series, bit_depth = _from_rig(session, exposures) if folder is None else _from_folder(folder)
    found = find_response([entry[0] for entry in series], [entry[1] for entry in series], bit_depth)
    if as_json:
        print_json({"linear": found.linear, "response": found, "shift_um": found.shift_widths() * width_um})
    else:
        click.echo("\n".join(found.lines(width_um)))
    return 0 if found.linear else 1


def _from_folder(folder: Path) -> tuple[list[tuple[float, Any]], int]:
    from acquire.pictures.bit_depth import SeenValues
    from acquire.pictures.listing import list_pictures, told
    from acquire.pictures.reader import PictureError, read_picture

    table, listing = _table(folder / TABLE), list_pictures(folder)
    odd, series, seen = list(listing.odd.items()), [], SeenValues()
    for path in listing.paths:
        match = _IN_NAME.search(path.name)
        exposure_ms = table.get(path.name, float(match.group(1).replace(",", ".")) if match else 0.0)
        if not 0 < exposure_ms <= MOST_MS:
            odd.append((path.name, f"has no exposure in its name (such as 12.5ms) nor in {TABLE}"))
            continue
        try:
            pixels = read_picture(path)
        except PictureError as error:
            odd.append((path.name, error.why))
            continue
        seen.add(pixels)
        series.append((exposure_ms, pixels))
    if not series:
        raise CalibrationError(f"no picture in {folder} can be used: {told(odd)}")
    for one in odd:
        click.echo(f"left out: {told([one])}", err=True)
    if len({pixels.dtype for _, pixels in series}) > 1:
        raise CalibrationError(f"the pictures in {folder} are of 8 and of 16 bit: take all with the same settings")
    if series[0][1].dtype == "uint8":
        return series, 8
    depth = seen.depth()
    return [(exposure_ms, depth.stored(pixels)) for exposure_ms, pixels in series], depth.bits


def _table(path: Path) -> dict[str, float]:
    import csv

    if not path.is_file():
        return {}
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            return {row[0].strip(): float(row[1]) for row in csv.reader(file) if row and not row[0].startswith("#")}
    except (OSError, ValueError, IndexError) as error:
        raise CalibrationError(f"{path} is no table of name,ms: {error}") from None


def _from_rig(session: Session, exposures: str | None) -> tuple[list[tuple[float, Any]], int]:
    from acquire.rig_tools.exposure_series import take_exposures
    from acquire.rigs.build import build_rig

    config = session.config().rig
    try:
        wished = [float(part) for part in exposures.split(",")] if exposures else None
        if wished and not all(0 < exposure_ms <= MOST_MS for exposure_ms in wished):
            raise ValueError
    except ValueError:
        raise click.BadParameter(
            f"exposures are positive numbers of ms, at most {MOST_MS:.0f}, with commas; they are {exposures!r}"
        ) from None
    chosen = wished or [share * config.camera.exposure_ms for share in DEFAULT_SHARES]
    taken = take_exposures(build_rig(config).camera, config, chosen)
    depth = config.simulation.bit_depth if config.camera.kind == "simulated" else 8 * taken[0].pixels.dtype.itemsize
    return [(one.exposure_ms, one.pixels) for one in taken], depth
