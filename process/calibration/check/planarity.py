"""Check of a calibration by a sweep over a board or a flat: flatness, offset, scale, shift of the light plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel, TranslatingPlane
from acquire.contract.errors import CalibrationError
from process.calibration.light_plane import robust
from process.calibration.light_plane.surfaces import Surface, meet
from process.calibration.light_plane.sweeps import FoldedSweep
from process.cloud.light_planes import plane_table
from process.cloud.triangulation import Hits, intersect, rays

from .spheres import least_rejected

F8 = NDArray[np.float64]
PATCH_PX = 64
"""Side of the patches over which local planarity is measured."""
MIN_PATCH_PIXELS = 50
MIN_CORNERS = 12
MIN_CORNER_PIXELS = 20


@dataclass(frozen=True)
class BoardScale:
    """Scale of the board's corners in the cloud against the board."""

    percent: float
    """Excess of distances in the cloud."""
    rms_um: float
    """Root mean square distance of the corners from the board after scaling."""
    corners: int


@dataclass(frozen=True)
class Repeatability:
    """Agreement of two sweeps over the same object."""

    points: int
    shift_um: float
    """Median change along the rays."""
    sd_um: float
    """Standard deviation of a point in one of them; 3 of 1000 left out."""

    def lines(self) -> list[str]:
        """The result as lines of text."""
        return [f"{self.points} points in both sweeps: shift {self.shift_um:+.3f} um, a point repeats within "
                f"{self.sd_um:.3f} um (standard deviation)"]  # fmt: skip


@dataclass(frozen=True)
class CheckResult:
    """Result of a sweep over a plane."""

    name: str
    points: int
    flatness_rms_um: float
    """RMS distance of the points from their own best plane, outliers left out."""
    flatness_range_um: float
    """Flatness error: between the 2.5th and the 97.5th percentile of that distance."""
    flatness_error_um: float
    """The same over all points but the 3 of 1000 that are furthest off (VDI/VDE 2634)."""
    local_rms_um: float
    """Median over patches of the RMS distance from the patch's own plane: noise without the bending."""
    tilt_deg: float | None
    """Between the points' plane and the board's own pose; None for a flat."""
    offset_um: float | None
    """Mean distance of the points from the board's pose, along its normal; None for a flat."""
    shift_t: float
    """Delay of the light against the calibration, in the unit of its parameter."""
    shift_um: float
    """The same along the light plane's normal."""
    zero_id: str = ""
    """Homing of the sweep; empty where that is not known."""
    scale: BoardScale | None = None
    """Distances in the cloud against the board; None for a flat."""

    def lines(self) -> list[str]:
        """The result as lines of text."""
        lines = [
            f"{self.name}: {self.points} points, flatness {self.flatness_error_um:.2f} um (95 %: "
            f"{self.flatness_range_um:.2f} um), RMS {self.flatness_rms_um:.2f} um, locally {self.local_rms_um:.2f} um",
            f"the light came {self.shift_t:+.2f} later than calibrated: {self.shift_um:+.2f} um along its normal",
        ]
        if self.offset_um is not None:
            lines.append(f"{self.offset_um:+.2f} um off the board's own pose, tilted by {self.tilt_deg:.4f} degrees")
        if self.scale is not None:
            lines.append(
                f"scale against the board's squares {self.scale.percent:+.4f} % ({self.scale.corners} corners, "
                f"{self.scale.rms_um:.2f} um RMS off the board)"
            )
        return lines


def cloud_of(sweep: FoldedSweep, camera: CameraModel, plane: TranslatingPlane) -> F8:
    """Points [h, w, 3] in mm of a folded sweep, NaN where there is none (algorithm 4).

    Raises:
        CalibrationError: the sweep's coordinate is not the plane's.
    """
    if sweep.parameter != plane.parameter:
        raise CalibrationError(
            f"the light plane counts in {plane.parameter}, {sweep.name} knows {sweep.parameter} only: use another sweep"
        )
    pixels = np.flatnonzero(np.isfinite(sweep.crossing.ravel()))
    hits = Hits(pixels, sweep.crossing.ravel()[pixels], sweep.sigma.ravel()[pixels].astype(np.float32))
    found = np.full((sweep.crossing.size, 3), np.nan)
    found[pixels] = intersect(rays(camera), plane_table(plane), sweep.frame_t, hits)[0]
    return found.reshape(*sweep.crossing.shape, 3)


def repeatability(first: F8, second: F8) -> Repeatability:
    """Compare two maps of points [h, w, 3] of the same object, pixel by pixel.

    Raises:
        CalibrationError: hardly a pixel has a point in both.
    """
    both = np.isfinite(first[..., 0]) & np.isfinite(second[..., 0])
    if int(both.sum()) < MIN_PATCH_PIXELS:
        raise CalibrationError("hardly a pixel has a point in both sweeps: are they of the same thing?")
    # points of one pixel lie on one ray, so their difference has a length and a sign
    change = second[both] - first[both]
    along = np.sign(change[:, 2]) * np.linalg.norm(change, axis=1) * 1000
    shift = float(np.median(along))
    kept = least_rejected(along - shift)
    return Repeatability(int(both.sum()), shift, float(kept.std()) / np.sqrt(2))


def check_surface(surface: Surface, camera: CameraModel, plane: TranslatingPlane) -> CheckResult:
    """Reconstruct the surface's pixels and compare them with a plane, and with its known pose.

    Raises:
        CalibrationError: the sweep's coordinate is not the plane's, or no pixel has a point.
    """
    sweep = surface.sweep
    points = cloud_of(sweep, camera, plane).reshape(-1, 3)[surface.pixels]
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
        # on a board some pixels are lit first by light from another square: those say nothing about flatness
        flatness_error_um=float(np.ptp(least_rejected(distance[near] if known else distance))) * 1000,
        local_rms_um=_local(points[near], pixels[near], sweep.crossing.shape[1]),
        tilt_deg=float(np.degrees(np.arccos(min(float(aligned @ surface.normal), 1.0)))) if known else None,
        offset_um=float(((points[near] - surface.point) @ surface.normal).mean()) * 1000 if known else None,
        shift_t=shift_t,
        shift_um=shift_t * float(n @ v) / float(np.linalg.norm(n)) * 1000,
        zero_id=sweep.zero_id,
        scale=_board_scale(surface, camera, points[near], pixels[near]) if known else None,
    )


def _board_scale(surface: Surface, camera: CameraModel, points: F8, pixels: NDArray[np.intp]) -> BoardScale | None:
    """Scale from the corners of the board in the cloud: each where its ray meets the plane of the points around it."""
    sighting = surface.sighting
    if sighting is None:
        return None
    row, column = np.divmod(pixels, surface.sweep.crossing.shape[1])
    view = rays(camera, sighting.pixels)
    board, cloud = [], []
    for place, mm, direction in zip(sighting.pixels, sighting.board_mm, view.directions, strict=True):
        near = (np.abs(column - place[0]) < sighting.pitch_px) & (np.abs(row - place[1]) < sighting.pitch_px)
        if int(near.sum()) < MIN_CORNER_PIXELS:
            continue
        own = points[near]
        middle = np.median(own, axis=0)
        own = own[np.linalg.norm(own - middle, axis=1) < 4 * np.median(np.linalg.norm(own - middle, axis=1))]
        middle = own.mean(axis=0)
        normal = np.linalg.svd(own - middle, full_matrices=False)[2][2]
        board.append(mm)
        cloud.append(view.centre_mm + direction * (normal @ (middle - view.centre_mm)) / (normal @ direction))
    if len(board) < MIN_CORNERS:
        return None
    return _scaled(np.array(board), np.array(cloud))


def _scaled(board: F8, cloud: F8) -> BoardScale:
    """Similarity transform from the board [n, 2] to the cloud [n, 3] by least squares (Umeyama)."""
    flat = np.column_stack([board, np.zeros(len(board))])
    a, b = flat - flat.mean(axis=0), cloud - cloud.mean(axis=0)
    left, values, right = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    scale = float((values * sign).sum() / (a**2).sum())
    off = b - scale * a @ (left * sign @ right).T
    rms = float(np.sqrt((off**2).sum(axis=1).mean())) * 1000
    return BoardScale(100 * (scale - 1), rms, len(board))


def _shift(surface: Surface, camera: CameraModel, plane: TranslatingPlane) -> float:
    """Mean of measured minus predicted t on the surface in its known pose, without outliers."""
    x = meet(rays(camera), surface.point, surface.normal, surface.pixels)
    n = np.array(plane.normal)
    wanted = ((x - np.array(plane.corner_origin_mm)) @ n) / float(n @ np.array(plane.corner_velocity_mm))
    late = surface.sweep.t.ravel()[surface.pixels] - wanted
    middle, scale = robust.median_and_scale(late)
    return float(late[np.abs(late - middle) <= 3 * max(scale, 1e-12)].mean())


def _best_plane(points: F8) -> tuple[F8, F8, NDArray[np.bool_]]:
    """Normal, signed distances [n] in mm, and which points are not outliers, by a robust fit of z over x and y."""
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
