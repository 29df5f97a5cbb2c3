"""The reference planes: read from their file, checked, and placed in the world by their four markers.

The file holds ``{"reference_planes": {"marker_rectangle_mm": [width, height], NAME: {"marker_corners_px": 4 x [x, y],
"image_region_px": [left, right, top, bottom]}, NAME: ...}}``; a plane may have a ``marker_rectangle_mm`` of its own.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from acquire.contract.errors import CalibrationError
from acquire.contract.files import read_text
from process.calibration.board.poses import PlanePose, find_pose

F8 = NDArray[np.float64]
MOST_MISFIT = 0.005
"""Corners that miss their rectangle by a larger share of the picture's width are refused."""
FAIR_MISFIT = 0.0015
"""A larger share is worth a remark: clicks are good to about a pixel."""
MOST_SHARED = 0.3
"""Regions may share so large a part of the smaller one."""
_ORDER = "marker_corners_px goes around the rectangle, its first two corners span the first length (the width)"
_REGION = "image_region_px is [left, right, top, bottom] in pixels, both ends included"


@dataclass(frozen=True)
class ReferencePlane:
    """A plane n . X = offset in the world, and the part of the picture that shows this plane."""

    name: str
    normal: F8
    offset: float
    region: tuple[int, int, int, int]
    """Columns from, to, rows from, to (both ends included)."""
    corners_px: F8
    """[4, 2] pixels, in order around the rectangle."""
    rectangle_mm: tuple[float, float]
    misfit_px: float
    """RMS distance of the corners from those of the rectangle."""
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Marked:
    """What the file says of one plane."""

    name: str
    corners_px: F8
    rectangle_mm: tuple[float, float]
    region: tuple[int, int, int, int]


def plane_from_markers(marked: Marked, camera: CameraModel) -> ReferencePlane:
    """The plane of a marker rectangle.

    Raises:
        CalibrationError: the corners are not those of such a rectangle; the message says what is wrong.
    """
    pose = _pose(marked, marked.rectangle_mm, camera)
    width, height = marked.rectangle_mm
    bound = MOST_MISFIT * camera.width
    if not pose.rms_px <= bound:
        turned = _pose(marked, (height, width), camera)
        hint = f": {_ORDER}; begin with the next corner" if turned.rms_px < 0.5 * pose.rms_px else _WRONG_RECTANGLE
        raise CalibrationError(
            f"{marked.name}: marker_corners_px miss a rectangle of {width:g} x {height:g} mm by {pose.rms_px:.1f} px "
            f"RMS, more than {bound:.1f}{hint}"
        )
    remarks = []
    if pose.rms_px > FAIR_MISFIT * camera.width:
        remarks.append(f"{marked.name}: corners that miss by {pose.rms_px:.1f} px tilt the plane; look at the picture")
    if pose.ambiguous:
        remarks.append(
            f"{marked.name}: its markers fit a plane that is tilted the other way nearly as well "
            f"({pose.mirrored_rms_px:.2f} px): a larger rectangle tells them apart"
        )
    to_world = np.array(camera.R).T
    normal = to_world @ pose.normal
    point = to_world @ (pose.translation - np.array(camera.T))
    return ReferencePlane(
        marked.name, normal, float(normal @ point), marked.region, marked.corners_px, marked.rectangle_mm,
        pose.rms_px, tuple(remarks),
    )  # fmt: skip


_WRONG_RECTANGLE = ": check the corners, marker_rectangle_mm, and that the camera's calibration is of this camera"


def _pose(marked: Marked, rectangle_mm: tuple[float, float], camera: CameraModel) -> PlanePose:
    width, height = rectangle_mm
    object_mm = np.array([[0.0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]])
    try:
        pose = find_pose(object_mm, marked.corners_px, np.array(camera.K), np.array(camera.distortion))
    except cv2.error:
        raise CalibrationError(f"{marked.name}: marker_corners_px are no corners of a rectangle: {_ORDER}") from None
    if not np.isfinite(pose.rms_px) or not np.isfinite(pose.translation).all():
        raise CalibrationError(f"{marked.name}: marker_corners_px are no corners of a rectangle: {_ORDER}")
    return pose


def read_planes(path: Path, camera: CameraModel) -> list[ReferencePlane]:
    """The planes of a file with ``reference_planes``, for a camera.

    Raises:
        CalibrationError: not there, not JSON, a key missing, malformed or out of bounds; by name.
    """
    return [plane_from_markers(marked, camera) for marked in read_marked(path, camera.width, camera.height)]


def read_marked(path: Path, width: int, height: int) -> list[Marked]:
    """What a file with ``reference_planes`` says, for pictures of this size.

    Raises:
        CalibrationError: as :func:`read_planes`.
    """
    try:
        document = json.loads(read_text(path))
    except OSError as error:
        raise CalibrationError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"{path} is no JSON: {str(error)[:120]}") from None
    fields = document.get("reference_planes") if isinstance(document, dict) else None
    if not isinstance(fields, dict):
        raise CalibrationError(f"{path} describes no reference planes: the key reference_planes is missing")
    planes = {name: plane for name, plane in fields.items() if isinstance(plane, dict)}
    if len(planes) != 2:
        named = ", ".join(planes) or "none"
        raise CalibrationError(f"{path}: it takes two reference planes; {len(planes)} were given ({named})")
    shared = fields.get("marker_rectangle_mm")
    try:
        found = [_marked(str(name), plane, shared, (width, height)) for name, plane in planes.items()]
        _refuse_swapped(found)
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from None
    return found


def _marked(name: str, plane: dict[str, Any], shared: Any, size: tuple[int, int]) -> Marked:
    rectangle = _rectangle(name, plane.get("marker_rectangle_mm", shared))
    corners = plane.get("marker_corners_px")
    if corners is None:
        raise CalibrationError(f"{name}: marker_corners_px is missing: four [x, y] in pixels; {_ORDER}")
    ok = isinstance(corners, list) and len(corners) == 4
    if not ok or not all(isinstance(c, list) and len(c) == 2 and all(map(_number, c)) for c in corners):
        raise CalibrationError(f"{name}: marker_corners_px is not four [x, y] of finite numbers")
    places = np.array(corners, dtype=np.float64)
    _check_order(name, places, size)
    return Marked(name, places, rectangle, _region(name, plane.get("image_region_px"), size))


def _number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _rectangle(name: str, value: Any) -> tuple[float, float]:
    if value is None:
        raise CalibrationError(f"{name}: marker_rectangle_mm is missing: [width, height] between the markers in mm")
    if not (isinstance(value, list) and len(value) == 2 and all(map(_number, value)) and min(value) > 0):
        raise CalibrationError(f"{name}: marker_rectangle_mm is not [width, height], two positive lengths in mm")
    return float(value[0]), float(value[1])


def _check_order(name: str, corners: F8, size: tuple[int, int]) -> None:
    """Refuse corners that do not go around a convex quadrangle, or lie far outside the picture."""
    width, height = size
    if (np.abs(corners - np.array([width, height]) / 2) > 2.0 * np.array([width, height])).any():
        raise CalibrationError(f"{name}: marker_corners_px lie outside of the picture of {width} x {height} pixels")
    sides = np.roll(corners, -1, axis=0) - corners
    after = np.roll(sides, -1, axis=0)
    turns = sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0]
    if (np.abs(turns) < 1.0).any():
        raise CalibrationError(f"{name}: three of marker_corners_px lie on one line: {_ORDER}")
    if not ((turns > 0).all() or (turns < 0).all()):
        raise CalibrationError(f"{name}: marker_corners_px cross over, two are swapped: {_ORDER}")


def _region(name: str, value: Any, size: tuple[int, int]) -> tuple[int, int, int, int]:
    if value is None:
        raise CalibrationError(f"{name}: image_region_px is missing: {_REGION}")
    if isinstance(value, list) and value and all(isinstance(v, list) and len(v) == 2 for v in value):
        if all(_number(x) for v in value for x in v):
            columns, rows = zip(*value, strict=True)
            meant = f"; for these corners [{min(columns):g}, {max(columns):g}, {min(rows):g}, {max(rows):g}]"
        else:
            meant = ""
        raise CalibrationError(f"{name}: image_region_px is given as corners; {_REGION}{meant}")
    if not (isinstance(value, list) and len(value) == 4 and all(map(_number, value))):
        raise CalibrationError(f"{name}: image_region_px is not four finite numbers; {_REGION}")
    if max(map(abs, value)) > 1e6:
        raise CalibrationError(f"{name}: image_region_px lies outside of the picture of {size[0]} x {size[1]} pixels")
    left, right, top, bottom = (round(v) for v in value)
    if right <= left or bottom <= top:
        corners = value[0] < value[2] and value[1] < value[3]
        meant = f"; if [x0, y0, x1, y1] was meant: [{left}, {top}, {right}, {bottom}]" if corners else ""
        raise CalibrationError(
            f"{name}: image_region_px {[left, right, top, bottom]} is empty or in another order; {_REGION}{meant}"
        )
    inside = max(left, 0), min(right, size[0] - 1), max(top, 0), min(bottom, size[1] - 1)
    if inside[1] - inside[0] < 8 or inside[3] - inside[2] < 8:
        raise CalibrationError(
            f"{name}: image_region_px {[left, right, top, bottom]} has less than 9 pixels either way in the picture of "
            f"{size[0]} x {size[1]}; {_REGION}"
        )
    return inside


def _refuse_swapped(planes: list[Marked]) -> None:
    """Refuse regions that are the same, or of which each lies in the middle of the other plane's markers."""
    (a, b, c, d), (e, f, g, h) = (marked.region for marked in planes)
    shared = max(min(b, f) - max(a, e) + 1, 0) * max(min(d, h) - max(c, g) + 1, 0)
    if shared > MOST_SHARED * min((b - a + 1) * (d - c + 1), (f - e + 1) * (h - g + 1)):
        raise CalibrationError(
            f"image_region_px of {planes[0].name} and {planes[1].name} overlap: each shows the edge on its own plane"
        )
    inside = [[_contains(marked, other) for other in planes] for marked in planes]
    if inside[0][1] and inside[1][0] and not inside[0][0] and not inside[1][1]:
        raise CalibrationError(
            f"image_region_px of {planes[0].name} and {planes[1].name} are swapped: "
            "each lies between the other's markers"
        )


def _contains(marked: Marked, other: Marked) -> bool:
    left, right, top, bottom = other.region
    outline = marked.corners_px.astype(np.float32).reshape(-1, 1, 2)
    return cv2.pointPolygonTest(outline, ((left + right) / 2, (top + bottom) / 2), False) > 0
