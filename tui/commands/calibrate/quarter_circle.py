"""The subcommand that calibrates the light plane from the slide's quarter circle on a white flat."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from acquire.contract.errors import CalibrationError
from tui.commands.calibrate.shared import LENGTH_MM, camera_option, out_option, save
from tui.commands.context import PATH, Number, force_option, json_option

if TYPE_CHECKING:
    from acquire.contract.calibration import Calibration
    from process.calibration.light_plane.compare import PlaneDifference
    from process.calibration.quarter_circle.calibrate import QuarterCircle


DAYS = 30.0
"""Validity of such a calibration."""


@click.command("quarter-circle")
@click.argument("scan", type=PATH)
@camera_option
@click.option(
    "--height-mm",
    type=Number(-1000, 1000),
    default=0.0,
    show_default=True,
    help="Height of the white flat above z = 0.",
)
@click.option("--points", type=PATH, help="Clicked points instead, JSON or CSV: point,frame,x,y.")
@click.option("--compare", type=PATH, help="Calibration to compare the light plane with [the camera's file].")
@click.option("--hs-mm", type=LENGTH_MM, default=3.81, show_default=True, help="Radius of the slide's quarter circle.")
@click.option(
    "--focal-mm", type=LENGTH_MM, default=50.0, show_default=True, help="Focal length f of the projector's lens."
)
@click.option("--xb-mm", type=LENGTH_MM, default=102.32, show_default=True, help="Distance xb of slide and lens.")
@out_option
@force_option
@json_option
def quarter_circle(
    scan: Path,
    camera_file: Path,
    height_mm: float,
    points: Path | None,
    compare: Path | None,
    hs_mm: float,
    focal_mm: float,
    xb_mm: float,
    out: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Calibrate the light plane from the slide's pattern, as it sweeps over a white flat.

    The corner, both straight edges and the arc are detected in every frame. Points given by hand are an alternative:
    corner in two frames or more, lead_end (end of the leading edge) and side_end (end of the other one)."""
    from acquire.contract.calibration import load_calibration
    from acquire.contract.scan_data.file_layout import read_layout
    from process.calibration.calibration_file import read_document, utc_now
    from process.calibration.quarter_circle.optics import Slide
    from process.calibration.report_page import quarter_circle_page

    if min(hs_mm, focal_mm, xb_mm) <= 0:
        raise CalibrationError("the sizes of the slide are positive: see --hs-mm, --focal-mm, --xb-mm")
    known = load_calibration(camera_file)[0]
    result = _found(scan, known, Slide(hs_mm, focal_mm, xb_mm), points, height_mm)
    other = known if compare is None else load_calibration(compare)[0]
    between = _between(other, result, known, named=compare is not None)
    document = read_document(camera_file)
    document["light_plane"] = result.document()
    document["valid_for"] = {"created_utc": utc_now(), "days": DAYS, "zero_id": read_layout(scan).zero_id or None}
    lines = result.lines()
    if between is not None:
        lines += between.lines("the other light plane", "the quarter circle")
    page = ("quarter-circle", quarter_circle_page(result, lines, between))
    save(out, document, lines, force=force or out == camera_file, as_json=as_json, page=page, difference=between)


def _found(scan: Path, known: Calibration, slide: object, points: Path | None, height_mm: float) -> QuarterCircle:
    from process.calibration.light_plane.sweeps import sweep_coordinate
    from process.calibration.quarter_circle.calibrate import find_quarter_circle
    from process.calibration.quarter_circle.clicks import plane_from_clicks, read_clicks

    if points is None:
        return find_quarter_circle(scan, known.camera, slide, height_mm=height_mm)  # type: ignore[arg-type]
    frame_t, parameter = sweep_coordinate(scan)
    return plane_from_clicks(
        read_clicks(points), known.camera, slide, frame_t=frame_t, parameter=parameter, height_mm=height_mm,  # type: ignore[arg-type]
    )  # fmt: skip


def _between(other: Calibration, result: QuarterCircle, known: Calibration, *, named: bool) -> PlaneDifference | None:
    import msgspec

    from acquire.contract.calibration import TranslatingPlane
    from process.calibration.light_plane.compare import difference

    if not isinstance(other.light_plane, TranslatingPlane):
        if named:
            raise CalibrationError("--compare names a calibration without a light plane that translates")
        return None
    own = msgspec.convert(result.document(), TranslatingPlane)
    return difference(other.light_plane, own, known.camera)
