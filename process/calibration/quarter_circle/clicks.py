"""Light plane from points of the quarter circle clicked by hand, for sweeps in which it is not found."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from acquire.contract.errors import CalibrationError
from acquire.contract.files import read_text, reason

from .calibrate import QuarterCircle, edge_turns, on_flat
from .optics import Slide, plane_normal

F8 = NDArray[np.float64]
MAX_FILE_BYTES = 1_000_000
Pixel = Annotated[float, msgspec.Meta(ge=-100_000, le=100_000)]
EXAMPLE = "corner,0,412.5,300; corner,526,...; lead_end,350,...; side_end,350,..."


class Click(msgspec.Struct, frozen=True):
    """A clicked point."""

    point: Literal["corner", "lead_end", "side_end"]
    """The corner, the end of the leading straight edge, or that of the other one."""
    frame: Annotated[int, msgspec.Meta(ge=0, le=100_000)]
    """0-based frame index."""
    x: Pixel
    y: Pixel


def read_clicks(path: Path) -> list[Click]:
    """Points of a JSON file (a list of {"point", "frame", "x", "y"}) or a CSV file (point,frame,x,y).

    Raises:
        CalibrationError: the file is missing or not readable, or holds no such points.
    """
    try:
        text = read_text(path, MAX_FILE_BYTES)
        if path.suffix.lower() == ".json":
            return msgspec.convert(json.loads(text), list[Click])
        return msgspec.convert(_rows(text), list[Click], strict=False)
    except OSError as error:
        raise CalibrationError(f"cannot read {path}: {reason(error)}") from None
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"{path} holds no points such as {EXAMPLE}: {str(error)[:120]}") from None


def _rows(text: str) -> list[dict[str, str]]:
    names = ("point", "frame", "x", "y")
    rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text)) if row and row[0].strip()]
    found = [dict(zip(names, row, strict=False)) for row in rows if tuple(row[:4]) != names and row[0][0] != "#"]
    if not found or any(len(row) != len(names) for row in found):
        raise ValueError("four columns are needed: point,frame,x,y")
    return found


def plane_from_clicks(
    clicks: list[Click], camera: CameraModel, slide: Slide, *, frame_t: F8, parameter: str, height_mm: float = 0.0
) -> QuarterCircle:
    """The light plane from clicked points: the corner in two frames or more, and both ends in some frame.

    Args:
        clicks: the points.
        camera: with its pose in the world.
        slide: sizes of slide and lens.
        frame_t: [frames] sweep coordinate.
        parameter: unit of that.
        height_mm: height of the flat.

    Raises:
        CalibrationError: missing points, points outside of the sweep, or impossible geometry.
    """
    beyond = [click for click in clicks if click.frame >= len(frame_t)]
    if beyond:
        raise CalibrationError(f"frame {beyond[0].frame} was clicked, the sweep has frames 0 to {len(frame_t) - 1}")
    corners = [click for click in clicks if click.point == "corner"]
    if len({click.frame for click in corners}) < 2:
        raise CalibrationError("the corner has to be given in two frames or more: it shows the motion")
    x, t = _places(corners, camera, height_mm), frame_t[[click.frame for click in corners]]
    design = np.column_stack([np.ones(len(t)), t])
    track = np.linalg.lstsq(design, x, rcond=None)[0]
    rms = float(np.sqrt(((x - design @ track) ** 2).sum(axis=1).mean())) * 1000
    ends = []
    for name in ("lead_end", "side_end"):
        own = [click for click in clicks if click.point == name]
        if not own:
            raise CalibrationError(f"no {name} was given: both ends of the pattern's straight edges are needed")
        at = frame_t[[click.frame for click in own]]
        offsets = _places(own, camera, height_mm) - np.column_stack([np.ones(len(at)), at]) @ track
        ends.append(np.array([*offsets.mean(axis=0), 0.0]))
    velocity = np.array([*track[1], 0.0])
    turns = edge_turns(slide, ends[0], ends[1], None)
    return QuarterCircle(
        slide, "rising", parameter, (), np.array([*track[0], height_mm]), velocity, rms, ends[0], ends[1],
        (float("nan"), float("nan")), turns, plane_normal(ends[0], ends[1], turns, velocity), float("nan"),
    )  # fmt: skip


def _places(clicks: list[Click], camera: CameraModel, height_mm: float) -> F8:
    return on_flat(camera, np.array([[click.x, click.y] for click in clicks]), height_mm)
