"""Owns checking a calibration with a sweep over a board or a flat: planarity, and how far the plane has shifted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel, TranslatingPlane
from acquire.contract.errors import CalibrationError
from process.geometry import Hits, intersect, plane_table, rays

from . import robust
from .surfaces import Surface

F8 = NDArray[np.float64]
PATCH_PX = 64
"""Side of the patches over which local planarity is measured."""
MIN_PATCH_PIXELS = 50


@dataclass(frozen=True)
class CheckResult:
    """What a sweep over a plane says of a calibration."""

    name: str
    points: int
    flatness_rms_um: float
    """RMS distance of the points from their own best plane, outliers left out."""
    flatness_range_um: float
    """Flatness error: between the 2.5th and the 97.5th percentile of that distance."""
    local_rms_um: float
    """Median over patches of the RMS distance from the patch's own plane: noise without the bending."""
    tilt_deg: float | None
    """Between the points' plane and the board's own pose; None for a flat."""
    offset_um: float | None
    """Mean distance of the points from the board's pose, along its normal; None for a flat."""
    shift_t: float
    """How much later the light came than the calibration says (unit of its parameter), median."""
    shift_um: float
    """The same along the light plane's normal."""

    def passed(self, limit_um: float) -> bool:
        """Flatness, and the offset where it is known, within a limit."""
        return self.flatness_range_um <= limit_um and (self.offset_um is None or abs(self.offset_um) <= limit_um)

    def words(self) -> list[str]:
        """For people."""
        lines = [
            f"{self.name}: {self.points} points, flatness {self.flatness_range_um:.2f} um (95 %), "
            f"RMS {self.flatness_rms_um:.2f} um, locally {self.local_rms_um:.2f} um",
            f"the light came {self.shift_t:+.2f} later than calibrated: {self.shift_um:+.2f} um along its normal",
        ]
        if self.offset_um is not None:
            lines.append(f"{self.offset_um:+.2f} um off the board's own pose, tilted by {self.tilt_deg:.4f} degrees")
        return lines


def check_surface(surface: Surface, camera: CameraModel, plane: TranslatingPlane) -> CheckResult:
    """Reconstruct the surface's pixels and compare them with a plane, and with its known pose.

    Raises:
        CalibrationError: the sweep's coordinate is not the plane's, or no pixel has a point.
    """
    sweep = surface.sweep
    if sweep.parameter != plane.parameter:
        raise CalibrationError(
            f"the light plane counts in {plane.parameter}, {sweep.name} knows {sweep.parameter} only: use another sweep"
        )
    crossing, sigma = sweep.crossing.ravel()[surface.pixels], sweep.sigma.ravel()[surface.pixels]
    hits = Hits(surface.pixels, crossing, sigma.astype(np.float32))
    points, _ = intersect(rays(camera), plane_table(plane), sweep.frame_t, hits)
    seen = np.isfinite(points[:, 0])
    if seen.sum() < MIN_PATCH_PIXELS:
        raise CalibrationError(f"{sweep.name}: the calibration gives no points there: is it that of this rig?")
    points, pixels = points[seen], surface.pixels[seen]
    normal, distance, near = _best_plane(points)
    flat = distance[near] * 1000
    low, high = np.percentile(flat, [2.5, 97.5])
    known = not surface.free_height
    aligned = normal if normal @ surface.normal > 0 else -normal
    n, v = np.array(plane.normal), np.array(plane.corner_velocity_mm)
    shift_t = _shift(surface, camera, plane) if known else 0.0
    return CheckResult(
        name=sweep.name,
        points=int(near.sum()),
        flatness_rms_um=float(np.sqrt((flat**2).mean())),
        flatness_range_um=float(high - low),
        local_rms_um=_local(points[near], pixels[near], sweep.crossing.shape[1]),
        tilt_deg=float(np.degrees(np.arccos(min(float(aligned @ surface.normal), 1.0)))) if known else None,
        offset_um=float(((points[near] - surface.point) @ surface.normal).mean()) * 1000 if known else None,
        shift_t=shift_t,
        shift_um=shift_t * float(n @ v) / float(np.linalg.norm(n)) * 1000,
    )


def _shift(surface: Surface, camera: CameraModel, plane: TranslatingPlane) -> float:
    """Median of measured minus predicted t on the surface's known pose."""
    view = rays(camera)
    directions = view.directions[surface.pixels]
    distance = (surface.normal @ (surface.point - view.centre_mm)) / (directions @ surface.normal)
    x = view.centre_mm + distance[:, None] * directions
    n = np.array(plane.normal)
    wanted = ((x - np.array(plane.corner_origin_mm)) @ n) / float(n @ np.array(plane.corner_velocity_mm))
    late = surface.sweep.t.ravel()[surface.pixels] - wanted
    middle = float(np.median(late))
    scale = robust.MAD_TO_SIGMA * float(np.median(np.abs(late - middle)))
    return float(late[np.abs(late - middle) <= 3 * max(scale, 1e-12)].mean())


def _best_plane(points: F8) -> tuple[F8, F8, NDArray[np.bool_]]:
    """Normal, signed distances [n] in mm, and which points are not outliers; z as a function of x and y, robustly."""
    design = np.column_stack([points[:, :2], np.ones(len(points))])
    fit = robust.solve(design, points[:, 2])
    normal = np.array([-fit.x[0], -fit.x[1], 1.0])
    length = float(np.linalg.norm(normal))
    return normal / length, (points[:, 2] - design @ fit.x) / length, fit.weight > 0


def _local(points: F8, pixels: NDArray[np.intp], width: int) -> float:
    row, column = np.divmod(pixels, width)
    patch = (row // PATCH_PX) * (width // PATCH_PX + 1) + column // PATCH_PX
    found = []
    for number in np.unique(patch):
        own = points[patch == number]
        if len(own) >= MIN_PATCH_PIXELS:
            middle = own.mean(axis=0)
            found.append(float(np.linalg.svd(own - middle, compute_uv=False)[-1]) / np.sqrt(len(own)))
    return float(np.median(found)) * 1000 if found else float("nan")
