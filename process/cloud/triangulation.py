"""Algorithm 4 of the paper, from crossings to points: camera rays, light planes, intersections and their sigma.

OpenCV's conventions: X_cam = R X_world + T (equation 1), pixel centres at integers, mm. All arithmetic is float64.
A ray is X = u + lambda v (equation 2), a light plane n(t) . X = d(t) (equation 3 with d = n . q), their intersection
lambda = (d - n . u) / (n . v) (equation 4). The paper's listings use R and T the other way round (camera to world);
here they are world to camera, as OpenCV returns them.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from acquire.contract.units import UM_PER_MM
from process.cloud.light_planes import PlaneTable
from process.numba_cache import inlined_kernel, kernel

F8 = NDArray[np.float64]

PARALLEL_SINE = 1e-9
"""A ray whose angle to the plane has a smaller sine never meets it within numbers that mean anything."""
_UNDISTORT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-9)
"""At most 50 iterations, until the pixel is met within 1e-9 px; OpenCV's default of 5 leaves strong lenses wrong."""


class Rays(NamedTuple):
    """One ray for each pixel: point = centre_mm + distance * directions, distance > 0 in front of the camera."""

    centre_mm: F8
    """[3], u = -R^T T: the camera's pinhole in world coordinates."""
    directions: F8
    """[n, 3], v = R^T K^-1 p' (undistorted); not normalised: one unit is 1 mm along the optical axis."""


class Hits(NamedTuple):
    """Where the light passed: pixels with their crossings."""

    pixels: NDArray[np.intp]
    """[n], flat indices into the image, row-major."""
    crossing: F8
    """[n], fractional 0-based frame index."""
    sigma: NDArray[np.float32]
    """[n], its standard deviation in frames."""


def rays(camera: CameraModel, pixels: F8 | None = None) -> Rays:
    """Rays of ``pixels`` (float [n, 2], x then y), or of the whole image in row-major order (cached).

    Source: equations (1) and (2); lens distortion is removed by OpenCV's iteration.
    """
    return _image_rays(camera) if pixels is None else _rays(camera, np.asarray(pixels, dtype=np.float64))


@lru_cache(maxsize=2)
def _image_rays(camera: CameraModel) -> Rays:
    x, y = np.meshgrid(np.arange(camera.width, dtype=np.float64), np.arange(camera.height, dtype=np.float64))
    found = _rays(camera, np.stack([x.ravel(), y.ravel()], axis=1))
    found.centre_mm.flags.writeable = False
    found.directions.flags.writeable = False
    return found


def _rays(camera: CameraModel, pixels: F8) -> Rays:
    rotation = np.array(camera.R)
    normalised = np.ones((len(pixels), 3))
    if len(pixels):
        found = cv2.undistortPoints(
            pixels.reshape(-1, 1, 2), np.array(camera.K), np.array(camera.distortion), criteria=_UNDISTORT
        )
        normalised[:, :2] = found.reshape(-1, 2)
    directions = normalised @ (-rotation if camera.mirrored else rotation)
    return Rays(-rotation.T @ np.array(camera.T), np.ascontiguousarray(directions))


def intersect(found_rays: Rays, table: PlaneTable, frame_t: F8, hits: Hits) -> tuple[F8, F8]:
    """Points of ``hits`` and their standard deviations along the ray.

    Args:
        found_rays: of the whole image.
        table: the light plane.
        frame_t: sweep coordinate of each frame index, [frames] (see :func:`light_planes.coordinates`).
        hits: pixels, crossings and sigmas, [n] each.

    Returns:
        points in mm, float64 [n, 3], NaN where there is none (no plane at that t, behind the camera, ray parallel to
        the plane), and sigma in um, float64 [n]: |dX/dt| |dt/dframe| sigma.
    """
    points = np.full((len(hits.pixels), 3), np.nan)
    sigma_um = np.full(len(hits.pixels), np.nan)
    _intersect(found_rays, table, frame_t, hits, (points, sigma_um))
    return points, sigma_um


@inlined_kernel
def _coordinate(frame_t, crossing):  # type: ignore[no-untyped-def]
    """Sweep coordinate t of a fractional frame index, and its change per frame."""
    frame = min(int(crossing), max(len(frame_t) - 2, 0))
    unit = frame_t[frame + 1] - frame_t[frame] if len(frame_t) > 1 else 0.0
    return frame_t[frame] + (crossing - frame) * unit, unit


@inlined_kernel
def _plane(table, t, plane, change):  # type: ignore[no-untyped-def]
    """Coefficients at t into ``plane``, their derivative into ``change``."""
    low, at, high = 0, t, 0
    if not np.isinf(table.first):
        low = min(int(t - table.first), max(len(table.nodes) - 2, 0))
        high = min(low + 1, len(table.nodes) - 1)
        at = t - table.first - low
        if at == 0.0 and low > 0 and np.isnan(table.nodes[high, 0]):  # the last plane before a gap
            low, at, high = low - 1, 1.0, low
    # a translating plane has one node and a slope, per-frame planes have many nodes and no slope: one formula for both
    for part in range(4):
        change[part] = table.slope[part] + table.nodes[high, part] - table.nodes[low, part]
        plane[part] = table.nodes[low, part] + at * change[part] if at != 1.0 else table.nodes[high, part]


@kernel
def _intersect(found_rays, table, frame_t, hits, found):  # type: ignore[no-untyped-def]
    """The loop of algorithm 4 over ``hits``; writes points [n, 3] and sigma_um [n] of ``found``, skips what misses."""
    centre = found_rays.centre_mm
    plane, change = np.empty(4), np.empty(4)
    points, sigma_um = found
    for index in range(len(hits.pixels)):
        crossing = hits.crossing[index]
        if not 0.0 <= crossing <= len(frame_t) - 1:
            continue
        t, unit = _coordinate(frame_t, crossing)
        if not table.first <= t <= table.last:
            continue
        _plane(table, t, plane, change)
        vx, vy, vz = found_rays.directions[hits.pixels[index]]
        along = plane[0] * vx + plane[1] * vy + plane[2] * vz
        # v is not normalised (1 along the optical axis), n neither where planes are interpolated
        length = np.sqrt(vx * vx + vy * vy + vz * vz)
        normal = np.sqrt(plane[0] * plane[0] + plane[1] * plane[1] + plane[2] * plane[2])
        if not abs(along) > PARALLEL_SINE * length * normal:
            continue
        # equation 4; behind the camera is no point, and `not >` also refuses NaN
        distance = (plane[3] - plane[0] * centre[0] - plane[1] * centre[1] - plane[2] * centre[2]) / along
        if not distance > 0.0:
            continue
        x, y, z = centre[0] + distance * vx, centre[1] + distance * vy, centre[2] + distance * vz
        points[index, 0], points[index, 1], points[index, 2] = x, y, z
        # n(t) . X(t) = d(t) derived by t, with X moving along the ray only: dlambda/dt = (d' - n' . X) / (n . v)
        speed = abs((change[3] - change[0] * x - change[1] * y - change[2] * z) / along) * length
        sigma_um[index] = hits.sigma[index] * speed * abs(unit) * UM_PER_MM
