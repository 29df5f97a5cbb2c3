"""Owns the light plane from sweeps over known surfaces: t = a . X + b by robust least squares over their pixels.

The crossing coordinate of a plane that only translates is affine in the point (design, section 5): n = a / |a|, and the
plane moves 1 / |a| along n per unit of t. What lies within the plane cannot be seen, and does not matter for points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from acquire.contract.errors import CalibrationError
from process.geometry import Rays, rays

from . import robust
from .documents import utc_now
from .plane_residuals import SurfaceResult, surface_results
from .surfaces import Surface, meet
from .sweeps import FoldedSweep
from .uncertainty import Spread, clustered, patches, spread

F8 = NDArray[np.float64]
MIN_THICKNESS_MM = 0.03
"""Least spread of the surfaces' points off their common plane."""
MIN_RAY_ANGLE_DEG = 5.0
FLOOR_FRAMES = 0.02
"""Added to every pixel's sigma: what the noise model does not know."""


@dataclass(frozen=True)
class PlaneResult:
    """A light plane from sweeps."""

    a: F8
    """[3] t per mm."""
    b: float
    spread: Spread
    """Covariance of (a, b), by source."""
    parameter: str
    edge: str
    method: str
    surfaces: tuple[SurfaceResult, ...]
    sweep: FoldedSweep
    notes: tuple[str, ...] = ()

    @property
    def normal(self) -> F8:
        """Unit normal, along growing t."""
        return np.asarray(self.a / np.linalg.norm(self.a), dtype=np.float64)

    @property
    def speed_mm(self) -> float:
        """Travel along the normal per unit of t."""
        return float(1.0 / np.linalg.norm(self.a))

    @property
    def normal_sd_deg(self) -> float:
        """Standard deviation of the normal's direction, worst axis."""
        return self.normal_sd_deg_of(self.spread.total)

    @property
    def speed_sd(self) -> float:
        """Relative standard deviation of the speed."""
        return float(np.sqrt(self.normal @ self.spread.total[:3, :3] @ self.normal)) * self.speed_mm

    def normal_sd_deg_of(self, covariance: F8) -> float:
        """The same of one source's covariance [4, 4]."""
        across = np.eye(3) - np.outer(self.normal, self.normal)
        tilt = across @ covariance[:3, :3] @ across * self.speed_mm**2
        return float(np.degrees(np.sqrt(max(float(np.linalg.eigvalsh(tilt).max()), 0.0))))

    @property
    def normal_sd_parts_deg(self) -> dict[str, float]:
        """Standard deviation of the normal by source: pixels, poses of the boards, camera and world."""
        parts = {"pixels": self.spread.pixels, "poses": self.spread.poses, "camera": self.spread.camera}
        return {name: self.normal_sd_deg_of(part) for name, part in parts.items()}

    @property
    def ok(self) -> bool:
        """All surfaces agree within LIMIT_UM."""
        return all(surface.ok for surface in self.surfaces)

    def validity(self, days: float) -> dict[str, Any]:
        """The ``valid_for`` object: the sweep that it was made with, and for how long it is meant."""
        plan = self.sweep.plan
        made: dict[str, Any] = {"created_utc": utc_now(), "days": days}
        if self.sweep.zero_id:
            made["zero_id"] = self.sweep.zero_id
        if plan is None:
            return made
        return made | {
            "first_steps": plan.first_steps,
            "steps_per_frame": plan.steps_per_frame,
            "direction": plan.direction,
            "mode": plan.mode,
        }

    def document(self) -> dict[str, Any]:
        """The ``light_plane`` object of calibration.json."""
        n, speed = self.normal, self.speed_mm
        return {
            "kind": "translating",
            "parameter": self.parameter,
            "edge": self.edge,
            "method": self.method,
            "normal": n.tolist(),
            "corner_origin_mm": (-self.b * speed * n).tolist(),
            "corner_velocity_mm": (speed * n).tolist(),
            "velocity_direction": "normal",
            "quality": {
                "source": "sweep",
                "ok": self.ok,
                "normal_sd_deg": self.normal_sd_deg,
                "normal_sd_parts_deg": self.normal_sd_parts_deg,
                "speed_sd_relative": self.speed_sd,
                "commanded_speed": "not determinable: sweeps show the motion along the normal only",
                "surfaces": [
                    {
                        "name": s.name, "pixels": s.pixels, "outlier_share": s.outlier_share, "mean_um": s.mean_um,
                        "rms_um": s.rms_um, "slope_um": s.slope_um, "bend_um": s.bend_um, "height_mm": s.height_mm,
                        "ok": s.ok, "cause": s.cause,
                    }
                    for s in self.surfaces
                ],
                "notes": list(self.notes),
            },
        }  # fmt: skip


def fit_plane(
    surfaces: Sequence[Surface], camera: CameraModel, *, edge: str, method: str, known_camera: F8 | None = None
) -> PlaneResult:
    """The light plane that explains the crossings on all surfaces.

    Args:
        surfaces: at least two that are not in one plane.
        camera: with its pose in the world.
        edge: ``rising`` or ``falling``, as the sweeps were folded.
        method: the crossing estimate they were folded with.
        known_camera: covariance [15, 15] of the camera's intrinsics and pose; None where it is not known.

    Raises:
        CalibrationError: sweeps in different units, surfaces in one plane, a plane along the view rays.
    """
    if len({surface.sweep.parameter for surface in surfaces}) != 1:
        raise CalibrationError("some sweeps know their stage positions and some do not: use sweeps of one kind")
    view = rays(camera)
    heights = np.zeros(len(surfaces))
    points, solution = _points(surfaces, heights, view), None
    for _ in range(6 if any(surface.free_height for surface in surfaces) else 1):
        _refuse_one_plane(points, surfaces)
        solution = _solve(surfaces, points, view)
        change = solution.x[4:]
        heights[[s.free_height for s in surfaces]] += change
        points = _points(surfaces, heights, view)
        if not len(change) or np.abs(change).max() < 1e-6:
            break
    assert solution is not None
    a, b = solution.x[:3], float(solution.x[3])
    _refuse_grazing(a, view)
    results = surface_results(surfaces, points, heights, a, b)
    first = surfaces[0].sweep
    notes = _speed_notes(a, first)
    if len({surface.sweep.zero_id for surface in surfaces if surface.sweep.zero_id}) > 1:
        notes = (*notes, "the stage was homed between the sweeps: they count from different zeros, take them in one go")
    if known_camera is None:
        notes = (*notes, "the camera's file does not say how uncertain it is: the standard deviations leave it out")
    own = _pixels_part(surfaces, points, solution, view)
    weight = solution.weight / _sigma(surfaces) ** 2
    found = spread(surfaces, heights, camera, weight, own, known_camera)
    return PlaneResult(a, b, found, first.parameter, edge, method, results, first, notes)


def _pixels_part(surfaces: Sequence[Surface], points: Sequence[F8], solution: robust.Solution, view: Rays) -> F8:
    """Covariance [4, 4] of (a, b) from the scatter of the pixels, neighbours taken as one; free heights included."""
    t, x = _crossings(surfaces), np.concatenate(points)
    design = np.column_stack([x, np.ones(len(x))])
    residual = t - design @ solution.x[:4]
    lift = _lift(surfaces, solution.x[:3], view)
    weight = solution.weight / _sigma(surfaces) ** 2
    return clustered(np.column_stack([design, lift]), residual, weight, patches(surfaces))[:4, :4]


def _points(surfaces: Sequence[Surface], heights: F8, view: Rays) -> list[F8]:
    return [
        meet(view, surface.point + height * surface.normal, surface.normal, surface.pixels)
        for surface, height in zip(surfaces, heights, strict=True)
    ]


def _solve(surfaces: Sequence[Surface], points: Sequence[F8], view: Rays) -> robust.Solution:
    """One linear step: a, b, and the change of each free height (through the ray: dX/dh along the ray)."""
    x = np.concatenate(points)
    t, sigma = _crossings(surfaces), _sigma(surfaces)
    design = np.column_stack([x, np.ones(len(x))])
    if not any(surface.free_height for surface in surfaces):
        return robust.solve(design, t, sigma)
    on_boards = np.concatenate([np.full(len(p), not s.free_height) for p, s in zip(points, surfaces, strict=True)])
    # the height's effect needs a, which the boards tell
    a = robust.solve(design[on_boards], t[on_boards], sigma[on_boards]).x[:3]
    return robust.solve(np.column_stack([design, _lift(surfaces, a, view)]), t, sigma)


def _crossings(surfaces: Sequence[Surface]) -> F8:
    """t of all pixels, one surface after the other."""
    return np.concatenate([surface.sweep.t.ravel()[surface.pixels] for surface in surfaces])


def _sigma(surfaces: Sequence[Surface]) -> F8:
    """Standard deviation of these, in the unit of t."""
    sigma = np.concatenate([
        np.hypot(surface.sweep.sigma.ravel()[surface.pixels], FLOOR_FRAMES) * abs(surface.sweep.unit_per_frame)
        for surface in surfaces
    ])  # fmt: skip
    return np.where(np.isfinite(sigma), sigma, np.nanmax(sigma))


def _lift(surfaces: Sequence[Surface], a: F8, view: Rays) -> F8:
    """Change of t per mm of each flat's height, [n, flats]: a point moves along its ray."""
    free = [index for index, surface in enumerate(surfaces) if surface.free_height]
    rows = np.concatenate([np.full(len(surface.pixels), index) for index, surface in enumerate(surfaces)])
    lift = np.zeros((len(rows), len(free)))
    for column, index in enumerate(free):
        directions = view.directions[surfaces[index].pixels]
        lift[rows == index, column] = directions @ a / (directions @ surfaces[index].normal)
    return lift


def _refuse_one_plane(points: Sequence[F8], surfaces: Sequence[Surface]) -> None:
    known = [p for p, surface in zip(points, surfaces, strict=True) if not surface.free_height]
    if not known:
        raise CalibrationError("flats alone cannot show the tilt of the light plane: add a sweep over the board")
    every = np.concatenate(known)
    spread = np.linalg.svd(every - every.mean(axis=0), compute_uv=False)[-1] / np.sqrt(len(every))
    if spread < MIN_THICKNESS_MM:
        raise CalibrationError(
            f"all sweeps lie in one plane (within {1000 * spread:.0f} um): the tilt of the light plane cannot be told; "
            "add a sweep over the board tilted by 5 degrees or more"
        )


def _refuse_grazing(a: F8, view: Rays) -> None:
    middle = view.directions.mean(axis=0)
    sine = abs(float(a @ middle)) / float(np.linalg.norm(a) * np.linalg.norm(middle))
    angle = float(np.degrees(np.arcsin(min(sine, 1.0))))
    if angle < MIN_RAY_ANGLE_DEG:
        raise CalibrationError(
            f"the light plane is parallel to the view rays within {angle:.1f} degrees: heights cannot be measured; "
            "tilt the projector"
        )


def _speed_notes(a: F8, sweep: FoldedSweep) -> tuple[str, ...]:
    per_unit_um = 1000.0 / float(np.linalg.norm(a))
    if sweep.parameter != "position_um":
        return ()
    notes = [f"the plane moves {per_unit_um:.4f} um along its normal per um of travel"]
    if per_unit_um > 1.02:
        notes.append("that is more than the stage travels: --square-mm or um_per_microstep is wrong")
    return tuple(notes)
