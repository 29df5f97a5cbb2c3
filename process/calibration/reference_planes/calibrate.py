"""One light plane per frame, from the lines in which its edge crosses two known planes: for hand-swept rigs, shadows.

The classic method that the paper cites ([8]) and could not use for want of depth of focus. Lengths in mm; t is the
1-based frame number.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from acquire.contract.errors import CalibrationError
from acquire.contract.files import read_text
from process.calibration.board.poses import find_pose
from process.calibration.light_plane import robust
from process.cloud.triangulation import Rays, rays

F8 = NDArray[np.float64]
WINDOW_FRAMES = 1.2
"""Pixels that cross within so many frames of a frame belong to its edge."""
MIN_EDGE_PIXELS = 40


@dataclass(frozen=True)
class ReferencePlane:
    """A plane n . X = offset in the world, and the part of the picture that shows only this plane."""

    name: str
    normal: F8
    offset: float
    region: tuple[int, int, int, int]
    """Columns from, to, rows from, to (both ends included)."""


@dataclass(frozen=True)
class FramePlane:
    """The light plane of one frame."""

    t: int
    """1-based frame number."""
    normal: F8
    offset: float
    skew_mm: float
    """Distance of the two lines; 0 if they lie in one plane."""
    angle_deg: float
    """Angle between the two lines: a plane from nearly parallel lines is uncertain."""


@dataclass(frozen=True)
class ReferenceResult:
    """Planes of a run of frames."""

    planes: tuple[FramePlane, ...]
    edge: str
    method: str
    camera_sd: tuple[float, float] | None = None
    """Standard deviation of a plane by that of the camera: mm at the middle of the scene, degrees; None: unknown."""

    @property
    def skew_mm(self) -> F8:
        """Distance of the two lines of each frame, [frames]."""
        return np.array([plane.skew_mm for plane in self.planes])

    def lines(self) -> list[str]:
        """The result as lines of text."""
        skew = sorted(self.skew_mm.tolist())
        lines = [
            f"planes for frames {self.planes[0].t} to {self.planes[-1].t} (1-based); the two lines of a frame miss "
            f"each other by {skew[len(skew) // 2]:.2f} mm (median), {skew[-1]:.2f} mm at most"
        ]
        if self.camera_sd is not None:
            lines.append(
                f"the camera's uncertainty alone moves them by {self.camera_sd[0]:.2f} mm at the middle of the scene "
                f"and turns them by {self.camera_sd[1]:.3f} degrees (standard deviations)"
            )
        return lines

    def document(self) -> dict[str, Any]:
        """The ``light_plane`` object of calibration.json."""
        return {
            "kind": "per-frame",
            "parameter": "frame",
            "edge": self.edge,
            "method": self.method,
            "first_frame": self.planes[0].t,
            "planes": [[*plane.normal.tolist(), plane.offset] for plane in self.planes],
            "quality": {
                "source": "reference-planes",
                "skew_mm": self.skew_mm.tolist(),
                "skew_median_mm": float(np.median(self.skew_mm)),
                "camera_sd_mm": self.camera_sd[0] if self.camera_sd else None,
                "camera_sd_deg": self.camera_sd[1] if self.camera_sd else None,
            },
        }


def plane_from_markers(
    name: str, corners_px: F8, rectangle_mm: tuple[float, float], region: tuple[int, int, int, int], camera: CameraModel
) -> ReferencePlane:
    """The plane of a marker rectangle from its corners [4, 2] px, in order around it, width first.

    Raises:
        CalibrationError: the corners are not those of such a rectangle.
    """
    width, height = rectangle_mm
    object_mm = np.array([[0.0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]])
    pose = find_pose(object_mm, np.asarray(corners_px, np.float64), np.array(camera.K), np.array(camera.distortion))
    if pose.rms_px > 0.01 * camera.width:
        raise CalibrationError(f"{name}: the markers miss a rectangle of {width} x {height} mm by {pose.rms_px:.1f} px")
    to_world = np.array(camera.R).T
    normal = to_world @ pose.normal
    point = to_world @ (pose.translation - np.array(camera.T))
    return ReferencePlane(name, normal, float(normal @ point), region)


def read_planes(path: Path, camera: CameraModel) -> list[ReferencePlane]:
    """The planes of a file with ``reference_planes``: a marker rectangle, and per plane its corners and region.

    Raises:
        CalibrationError: not there, not JSON, or a key missing; by name.
    """
    try:
        fields = json.loads(read_text(path))["reference_planes"]
        rectangle = (float(fields["marker_rectangle_mm"][0]), float(fields["marker_rectangle_mm"][1]))
        return [
            plane_from_markers(
                name, np.array(plane["marker_corners_px"], dtype=np.float64), rectangle,
                _region(plane["image_region_px"]), camera,
            )
            for name, plane in fields.items()
            if isinstance(plane, dict)
        ]  # fmt: skip
    except OSError as error:
        raise CalibrationError(f"cannot read {path}: {error.strerror}") from None
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise CalibrationError(f"{path} describes no reference planes: {type(error).__name__} {error}") from None


def _region(values: Sequence[Any]) -> tuple[int, int, int, int]:
    left, right, top, bottom = (int(value) for value in values)
    return left, right, top, bottom


def fit_reference_planes(
    crossing: F8, planes: Sequence[ReferencePlane], camera: CameraModel, *, edge: str, method: str, every: int = 1
) -> ReferenceResult:
    """Fit one plane for each frame whose edge is seen on both of two planes.

    Args:
        crossing: [h, w] 0-based frame index, NaN where there is none.
        planes: the two.
        camera: with its pose in the world.
        edge: as the sweep was folded.
        method: the crossing estimate.
        every: step between the frames that get a plane.

    Raises:
        CalibrationError: not two planes, parallel planes, or no frame that shows its edge on both.
    """
    if len(planes) != 2:
        raise CalibrationError(f"it takes two reference planes; {len(planes)} were given")
    if abs(float(planes[0].normal @ planes[1].normal)) > 0.999:
        raise CalibrationError("the two reference planes are parallel: the light plane cannot be told from its lines")
    view = rays(camera)
    samples = [_samples(crossing, plane, view) for plane in planes]
    low = max(np.ceil(np.percentile(t, 0.5)) for _, t in samples)
    high = min(np.floor(np.percentile(t, 99.5)) for _, t in samples)
    found: list[FramePlane] = []
    for index in range(int(low), int(high) + 1, every):
        lines = [_line(points, t, float(index), plane) for (points, t), plane in zip(samples, planes, strict=True)]
        if lines[0] is None or lines[1] is None:
            if found:
                break
            continue
        found.append(_plane(index + 1, lines[0], lines[1]))
    if not found:
        raise CalibrationError("no frame shows the edge on both reference planes: are regions and edge right?")
    return ReferenceResult(tuple(found), edge, method)


def _samples(crossing: F8, plane: ReferencePlane, view: Rays) -> tuple[F8, F8]:
    """Points on the plane [n, 3] and their crossings [n]."""
    left, right, top, bottom = plane.region
    part = crossing[top : bottom + 1, left : right + 1]
    row, column = np.nonzero(np.isfinite(part))
    pixels = (row + top) * crossing.shape[1] + column + left
    directions = view.directions[pixels]
    distance = (plane.offset - plane.normal @ view.centre_mm) / (directions @ plane.normal)
    return view.centre_mm + distance[:, None] * directions, crossing.ravel()[pixels]


def _line(points: F8, t: F8, at: float, plane: ReferencePlane) -> tuple[F8, F8, float] | None:
    """The edge of a frame on a plane: a point, a unit direction, half the seen length; in mm.

    Near the edge the crossing is linear across it, t = g . X + c by a robust fit; the line is where t is the frame's.
    """
    near = np.abs(t - at) < WINDOW_FRAMES
    if int(near.sum()) < MIN_EDGE_PIXELS:
        return None
    middle = points[near].mean(axis=0)
    across = np.linalg.svd(plane.normal[None])[2][1:]
    local = (points[near] - middle) @ across.T
    design = np.column_stack([local, np.ones(len(local))])
    slope = robust.solve(design, t[near] - at, seed=1)
    keep = slope.weight > 0.05
    gradient, rest = slope.x[:2], float(slope.x[2])
    steep = float(gradient @ gradient)
    if steep <= 0:
        return None
    direction = np.array([-gradient[1], gradient[0]]) / np.sqrt(steep)
    along = local[keep] @ direction
    foot = -rest * gradient / steep + direction * along.mean()
    return middle + foot @ across, direction @ across, float(along.std()) + 1e-9


def _plane(t: int, first: tuple[F8, F8, float], second: tuple[F8, F8, float]) -> FramePlane:
    """The plane through both lines by least squares over the lengths that were seen."""
    ends = [place + sign * direction * half for place, direction, half in (first, second) for sign in (-1.7, 1.7)]
    points = np.array(ends)
    middle = points.mean(axis=0)
    normal = np.linalg.svd(points - middle)[2][2]
    between = np.cross(first[1], second[1])
    length = float(np.linalg.norm(between))
    skew = abs(float((second[0] - first[0]) @ between)) / length if length > 1e-9 else 0.0
    normal = normal if normal[int(np.abs(normal).argmax())] > 0 else -normal
    angle = float(np.degrees(np.arcsin(min(length, 1.0))))
    return FramePlane(t, np.asarray(normal), float(normal @ middle), skew, angle)
