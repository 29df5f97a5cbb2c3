"""Spheres in a map of points: detection, fit, and probing errors by VDI/VDE 2634 part 2."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError
from process.calibration.light_plane import robust

F8 = NDArray[np.float64]
REJECTED_SHARE = 0.003
"""Share of the points that may be left out of a probing or flatness error."""
MIN_POINTS = 500
MOST_POINTS = 60_000
PLANE_SHARE = 0.3
"""A plane that holds at least this share of the cloud is the stage."""
PLANE_MM = 0.02
ROUNDNESS = 0.05
"""Residual, as a share of the radius, beyond which a part of the cloud is no sphere."""
TUKEY = 6.0
ROUNDS = 30


@dataclass(frozen=True)
class Sphere:
    """A fitted sphere."""

    centre: F8
    """[3] mm."""
    radius_mm: float
    points: int
    form_um: float
    """Probing error (form): range of the radial distances from the best sphere of free radius."""
    rms_um: float

    @property
    def diameter_mm(self) -> float:
        """Twice the radius."""
        return 2 * self.radius_mm


def find_spheres(points: F8) -> list[Sphere]:
    """Find the spheres in a map of points, the largest part first.

    Args:
        points: [h, w, 3] mm, NaN where there is none.

    Raises:
        CalibrationError: no part of the cloud is round.
    """
    seen = np.isfinite(points[..., 0])
    seen &= ~_stage(points, seen)
    closed = cv2.morphologyEx(seen.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    closed = cv2.morphologyEx(closed, cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    count, labels = cv2.connectedComponents(closed)
    found = []
    for label in range(1, count):
        own = points[(labels == label) & seen]
        if len(own) >= MIN_POINTS:
            sphere = fit_sphere(own[:: max(len(own) // MOST_POINTS, 1)])
            if sphere is not None:
                found.append(sphere)
    if not found:
        raise CalibrationError(
            "no sphere was found in the cloud: is it in the field, matt, and apart from other things?"
        )
    return sorted(found, key=lambda sphere: -sphere.points)


def _stage(points: F8, seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask of the pixels of the plane that the spheres lie on, by RANSAC; empty where there is no plane."""
    some = points[seen]
    none = np.zeros_like(seen)
    if len(some) < MIN_POINTS:
        return none
    few = some[:: max(len(some) // 4000, 1)]
    generator = np.random.default_rng(0)
    best, most = np.zeros(4), 0
    for _ in range(200):
        a, b, c = few[generator.integers(0, len(few), 3)]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length < 1e-9:
            continue
        normal /= length
        near = int((np.abs((few - a) @ normal) < PLANE_MM).sum())
        if near > most:
            best, most = np.array([*normal, normal @ a]), near
    if most < PLANE_SHARE * len(few):
        return none
    plane: NDArray[np.bool_] = seen & (np.abs(points @ best[:3] - best[3]) < PLANE_MM)
    return plane


def fit_sphere(points: F8) -> Sphere | None:
    """Robust fit of a sphere to points [n, 3] mm; None where they are not round."""
    middle = points.mean(axis=0)
    x = points - middle
    # start: |x|^2 = 2 c . x + r^2 - |c|^2 is linear in c and r^2 - |c|^2
    start = np.linalg.lstsq(np.column_stack([2 * x, np.ones(len(x))]), (x**2).sum(axis=1), rcond=None)[0]
    inside = float(start[3] + start[:3] @ start[:3])
    if inside <= 0:
        return None
    centre, radius = start[:3], float(np.sqrt(inside))
    for _ in range(ROUNDS):
        offset = x - centre
        distance = np.linalg.norm(offset, axis=1)
        residual = distance - radius
        # Gauss-Newton on the radial distance, with Tukey's weights
        scale = max(robust.MAD_TO_SIGMA * float(np.median(np.abs(residual))), 1e-9)
        root = np.clip(1 - (residual / (TUKEY * scale)) ** 2, 0, None)
        design = np.column_stack([-offset / distance[:, None], -np.ones(len(x))])
        step = np.linalg.lstsq(design * root[:, None], -residual * root, rcond=None)[0]
        centre, radius = centre + step[:3], radius + float(step[3])
        if np.abs(step).max() < 1e-10:
            break
    residual = np.linalg.norm(x - centre, axis=1) - radius
    if float(np.median(np.abs(residual))) > ROUNDNESS * radius or float(np.ptp(x[:, :2])) < 0.2 * radius:
        return None
    kept = least_rejected(residual)
    return Sphere(
        centre + middle, radius, len(points), float(np.ptp(kept)) * 1000, float(np.sqrt((kept**2).mean())) * 1000
    )


def least_rejected(residual: F8) -> F8:
    """Residuals without the REJECTED_SHARE that are furthest off."""
    kept = np.sort(np.abs(residual))
    limit = kept[min(int(np.ceil(len(kept) * (1 - REJECTED_SHARE))), len(kept)) - 1]
    return np.asarray(residual[np.abs(residual) <= limit])
