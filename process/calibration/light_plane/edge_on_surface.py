"""When the light passes three places of a surface: robust fit over all its pixels, with covariance.

On a plane t is affine in the place, whatever the pose of the plane. So outliers are found without knowing the pose
well, and a hundred thousand pixels reduce to three values of t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from acquire.contract.errors import CalibrationError
from process.cloud.triangulation import rays

from . import robust
from .surfaces import Surface, meet

F8 = NDArray[np.float64]
FLOOR_FRAMES = 0.02
"""Added to each pixel's sigma in squares: errors beyond the noise model."""
PATCHES_ACROSS = 16
"""Pixels within a sixteenth of the picture's width are taken to have a common error,"""
PATCHES_ON_SURFACE = 8
"""or within an eighth of the surface, if that is less."""
COMMON_FLOOR_FRAMES = 0.005
"""Least standard deviation of t on a surface: an error that all its pixels share does not average out."""
_TRIANGLE = np.array([[0.0, -1.0], [-0.866, 0.5], [0.866, 0.5]])


@dataclass(frozen=True)
class LightPassage:
    """Times at which the light passes a surface."""

    places: F8
    """[3, 2] px: a triangle in the middle of the surface."""
    t: F8
    """[3] sweep coordinate at which the light passes there."""
    covariance: F8
    """[3, 3] covariance of t."""
    weight: F8
    """[n] 0..1 of the surface's pixels; 0 is an outlier."""


def light_passage(surface: Surface, camera: CameraModel) -> LightPassage:
    """Fit the times at which the light passes a surface whose pose is known roughly.

    Raises:
        CalibrationError: the surface's pixels lie on a line.
    """
    on_plane = _SurfaceCoordinates(surface, camera)
    solution = robust.solve(on_plane.rows, crossings(surface), sigmas(surface))
    return on_plane.passage(solution.x, solution.weight)


def light_passage_again(before: LightPassage, surface: Surface, camera: CameraModel) -> LightPassage:
    """Repeat the fit for a better known pose, with the same outliers."""
    on_plane = _SurfaceCoordinates(surface, camera)
    root = np.sqrt(before.weight) / sigmas(surface)
    x = np.linalg.lstsq(on_plane.rows * root[:, None], crossings(surface) * root, rcond=None)[0]
    return on_plane.passage(np.asarray(x, dtype=np.float64), before.weight)


def crossings(surface: Surface) -> F8:
    """Sweep coordinate t [n] of the surface's pixels."""
    return np.asarray(surface.sweep.t.ravel()[surface.pixels], dtype=np.float64)


def sigmas(surface: Surface) -> F8:
    """Standard deviation [n] of these, in the unit of t."""
    sweep = surface.sweep
    sigma = np.hypot(sweep.sigma.ravel()[surface.pixels], FLOOR_FRAMES) * abs(sweep.unit_per_frame)
    return np.where(np.isfinite(sigma), sigma, np.nanmax(sigma))


class _SurfaceCoordinates:
    """Coordinates on a surface's plane, about the middle of its pixels, scaled to the order of 1."""

    def __init__(self, surface: Surface, camera: CameraModel) -> None:
        points = meet(rays(camera), surface.point, surface.normal, surface.pixels)
        self._surface, self._camera, self._middle = surface, camera, points.mean(axis=0)
        sizes, axes = np.linalg.svd(points - self._middle, full_matrices=False)[1:]
        if sizes[1] < 1e-3 * sizes[0]:
            raise CalibrationError(f"{surface.sweep.name}: the clean pixels lie on a line: sweep all of the surface")
        self._axes = axes[:2] * (np.sqrt(len(points)) / sizes[0])
        self.rows = self._at(points)

    def _at(self, points: F8) -> F8:
        """Two coordinates and 1, [n, 3], of points [n, 3]."""
        return np.column_stack([(points - self._middle) @ self._axes.T, np.ones(len(points))])

    def passage(self, x: F8, weight: F8) -> LightPassage:
        """Times at three places, of t = rows @ x, with their covariance."""
        surface = self._surface
        residual, weights = crossings(surface) - self.rows @ x, weight / sigmas(surface) ** 2
        covariance = clustered(self.rows, residual, weights, patches(surface))
        places = _triangle(surface)
        there = self._at(meet(rays(self._camera, places), surface.point, surface.normal, None))
        floor = (COMMON_FLOOR_FRAMES * abs(surface.sweep.unit_per_frame)) ** 2 * np.eye(3)
        return LightPassage(places, there @ x, there @ covariance @ there.T + floor, weight)


def _triangle(surface: Surface) -> F8:
    row, column = np.divmod(surface.pixels, surface.sweep.crossing.shape[1])
    places = np.column_stack([column, row]).astype(np.float64)
    return np.asarray(places.mean(axis=0) + 1.4 * places.std(axis=0) * _TRIANGLE, dtype=np.float64)


def patches(surface: Surface) -> NDArray[np.intp]:
    """Number of the patch that each pixel belongs to, [n]."""
    width = surface.sweep.crossing.shape[1]
    row, column = np.divmod(surface.pixels, width)
    extent = min(int(np.ptp(row)), int(np.ptp(column))) + 1
    side = max(min(width // PATCHES_ACROSS, extent // PATCHES_ON_SURFACE), 1)
    return np.asarray((row // side) * (width // side + 1) + column // side, dtype=np.intp)


def clustered(design: F8, residual: F8, weight: F8, group: NDArray[np.intp]) -> F8:
    """Covariance [k, k] of weighted least squares with common errors within groups (cluster-robust sandwich estimator).

    Args:
        design: [n, k].
        residual: [n].
        weight: [n], of the squares.
        group: [n], number of each row's group.
    """
    unit = np.sqrt((design**2).mean(axis=0))
    rows = design / unit
    # the sandwich: inverse normal matrix, scatter of the groups' summed gradients, inverse normal matrix
    bread = np.linalg.pinv(rows.T @ (rows * weight[:, None]), hermitian=True)
    pull = rows * (weight * residual)[:, None]
    count = int(group.max()) + 1
    sums = np.stack([np.bincount(group, column, count) for column in pull.T], axis=1)
    groups = len(np.unique(group))
    meat = sums.T @ sums * groups / max(groups - design.shape[1], 1)
    return np.asarray(bread @ meat @ bread / np.outer(unit, unit))
