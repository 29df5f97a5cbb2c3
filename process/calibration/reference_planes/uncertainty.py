"""Uncertainty of planes from reference planes by that of the camera, which often dominates."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from process.cloud.triangulation import rays

from .calibrate import FramePlane, ReferencePlane, fit_reference_planes

F8 = NDArray[np.float64]
FRAMES = 12
LEAST_SHARE = 1e-9
"""Axes of the covariance with a smaller share of its largest variance are skipped."""


def camera_sd(
    crossing: F8,
    known: Callable[[CameraModel], Sequence[ReferencePlane]],
    camera: CameraModel,
    covariance: F8,
    *,
    edge: str,
    method: str,
    frames: int,
) -> tuple[float, float]:
    """Standard deviation of a plane's distance at the middle of the scene in mm, and of its direction in degrees.

    Args:
        crossing: [h, w] 0-based frame index.
        known: the reference planes for a camera; the markers' pixels stay.
        camera: the camera.
        covariance: [15, 15] of its intrinsics and world; only the intrinsics act here.
        edge: as folded.
        method: the crossing estimate.
        frames: number of planes; a dozen of them are tried.
    """
    every = max(frames // FRAMES, 1)

    def planes(model: CameraModel) -> tuple[FramePlane, ...]:
        return fit_reference_planes(crossing, known(model), model, edge=edge, method=method, every=every).planes

    nominal = {plane.t: plane for plane in planes(camera)}
    middle = _middle(known(camera), camera)
    values, vectors = np.linalg.eigh(covariance[:9, :9])
    squares = {t: np.zeros(2) for t in nominal}
    for value, axis in zip(values, vectors.T, strict=True):
        if value <= LEAST_SHARE * values[-1]:
            continue
        for plane in planes(_moved(camera, np.sqrt(value) * axis)):
            if plane.t in nominal:
                squares[plane.t] += _change(nominal[plane.t], plane, middle) ** 2
    rms = np.sqrt(np.mean(list(squares.values()), axis=0))
    return float(rms[0]), float(rms[1])


def _moved(camera: CameraModel, step: F8) -> CameraModel:
    (fx, skew, cx), (_, fy, cy), _ = camera.K
    matrix = ((fx + step[0], skew, cx + step[2]), (0.0, fy + step[1], cy + step[3]), (0.0, 0.0, 1.0))
    k1, k2, p1, p2, k3 = (value + change for value, change in zip(camera.distortion, step[4:], strict=True))
    return CameraModel(
        width=camera.width, height=camera.height, K=matrix, R=camera.R, T=camera.T, distortion=(k1, k2, p1, p2, k3),
        mirrored=camera.mirrored,
    )  # fmt: skip


def _middle(planes: Sequence[ReferencePlane], camera: CameraModel) -> F8:
    """Point [3] mm between the middles of both regions."""
    view, places = rays(camera), []
    for plane in planes:
        left, right, top, bottom = plane.region
        direction = view.directions[(top + bottom) // 2 * camera.width + (left + right) // 2]
        distance = (plane.offset - plane.normal @ view.centre_mm) / (direction @ plane.normal)
        places.append(view.centre_mm + distance * direction)
    return np.asarray(np.mean(places, axis=0))


def _change(before: FramePlane, after: FramePlane, middle: F8) -> F8:
    """[2]: change of the distance in mm at the foot of ``middle``, and of the direction in degrees."""
    foot = middle - (before.normal @ middle - before.offset) * before.normal
    angle = np.degrees(np.arccos(min(abs(float(before.normal @ after.normal)), 1.0)))
    return np.array([after.normal @ foot - after.offset, angle])
