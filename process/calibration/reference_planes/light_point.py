"""The point that all light planes of a sweep have in common, where the lamp is (nearly) a point; it may be far away.

A plane n . X = d contains the lamp L if n . L = d. In coordinates about the middle c of the scene, scaled by its size
s, (n, n . c - d) . (L - c, s w) = 0: the smallest singular vector, with Tukey's weights. A lamp at infinity has w = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from process.calibration.light_plane import robust

F8 = NDArray[np.float64]
LEAST_PLANES = 10
HOLDS_DEG = 0.15
"""Planes that scatter about the common point by more (robust standard deviation) have none that could be used."""
MISS_SIGMAS = 8.0
LEAST_MISS_DEG = 0.5
"""A plane may miss the point by as much, and by so many standard deviations of the others."""
FAR = 1e4
"""A lamp further away than so many sizes of the scene counts as there."""


@dataclass(frozen=True)
class LightPoint:
    """The common point."""

    place: F8
    """[3] mm."""
    scene: F8
    """[3] mm, the middle of the scene."""
    scatter_deg: float
    """Robust standard deviation of the angles by which planes miss it, seen from the scene."""

    @property
    def distance_mm(self) -> float:
        """From the middle of the scene."""
        return float(np.linalg.norm(self.place - self.scene))

    @property
    def sd_mm(self) -> float:
        """What a plane may miss it by."""
        return float(np.radians(max(self.scatter_deg, 0.02))) * self.distance_mm

    @property
    def bound_deg(self) -> float:
        """A plane that misses it by more is wrong."""
        return max(MISS_SIGMAS * self.scatter_deg, LEAST_MISS_DEG)

    def miss_deg(self, normals: F8, offsets: F8) -> F8:
        """Angles [n] by which planes miss it."""
        gap = (normals @ self.place - offsets) / self.distance_mm
        return np.asarray(np.degrees(np.abs(np.arcsin(np.clip(gap, -1, 1)))))


def find_light_point(normals: F8, offsets: F8, scene: F8, size_mm: float) -> LightPoint | None:
    """The common point of planes [n, 3], [n]; None where there are few planes, or they have none in common."""
    if len(normals) < LEAST_PLANES:
        return None
    rows = np.column_stack([normals, (normals @ scene - offsets) / size_mm])
    point, _ = _smallest(rows)
    lift = point[3] if abs(point[3]) > 1.0 / FAR * np.linalg.norm(point[:3]) else np.copysign(1 / FAR, point[3])
    found = LightPoint(scene + size_mm * point[:3] / lift, scene, 0.0)
    if found.distance_mm < 1e-6 * size_mm:
        return None
    miss = found.miss_deg(normals, offsets)
    scatter = robust.MAD_TO_SIGMA * float(np.median(miss))
    return LightPoint(found.place, scene, scatter) if scatter <= HOLDS_DEG else None


def _smallest(rows: F8) -> tuple[F8, F8]:
    """Unit vector [4] with the least robust sum of squares of rows @ vector, and the weights [n]."""
    best, least = np.zeros(4), np.inf
    generator = np.random.default_rng(1)
    for _ in range(300):  # a start that holds against many wrong planes
        pick = rows[generator.choice(len(rows), 4, replace=False)]
        point = np.linalg.svd(pick)[2][3]
        middle = float(np.median(np.abs(rows @ point)) / max(np.linalg.norm(point[:3]), 1e-9))
        if middle < least:
            best, least = point, middle
    weight = np.ones(len(rows))
    for _ in range(20):
        gap = rows @ best
        scale = max(robust.MAD_TO_SIGMA * float(np.median(np.abs(gap))), 1e-12)
        weight = np.clip(1 - (gap / (robust.TUKEY * scale)) ** 2, 0, None) ** 2
        best = np.linalg.svd(rows * np.sqrt(weight)[:, None], full_matrices=False)[2][3]
    return best, weight
