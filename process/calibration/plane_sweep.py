"""Owns the light plane from sweeps over known surfaces: t = a . X + b by robust least squares over their pixels.

The crossing coordinate of a plane that only translates is affine in the point (design, section 5): n = a / |a|, and the
plane moves 1 / |a| along n per unit of t. What lies within the plane cannot be seen, and does not matter for points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from acquire.contract.errors import CalibrationError
from process.geometry import Rays, rays

from . import robust
from .boards import Board, find_board
from .documents import utc_now
from .poses import find_pose
from .sweeps import FoldedSweep

F8 = NDArray[np.float64]
BLUR_WIDTHS = 3.0
BLUR_PX = 1.0
"""Width of the camera's own blur: pixels within three of it from a printed edge see both squares."""
MOST_OF_SQUARE = 0.35
"""However small the squares are, so much of them on each side is left out at most."""
MOST_PIXELS = 120_000
"""Per surface; more are thinned evenly."""
MIN_PIXELS = 300
LIMIT_UM = 1.0
"""A surface whose mean residual is larger contradicts the others."""
MIN_THICKNESS_MM = 0.03
"""Least spread of the surfaces' points off their common plane."""
MIN_RAY_ANGLE_DEG = 5.0
FLOOR_FRAMES = 0.02
"""Added to every pixel's sigma: what the noise model does not know."""


@dataclass(frozen=True)
class Surface:
    """A known surface in the world: a plane through ``point`` with ``normal``."""

    sweep: FoldedSweep
    point: F8
    normal: F8
    pixels: NDArray[np.intp]
    """[n] flat indices of the pixels to use."""
    free_height: bool = False
    """A matt white flat parallel to z = 0 whose height is estimated."""


@dataclass(frozen=True)
class SurfaceResult:
    """How one surface agrees with the plane."""

    name: str
    pixels: int
    outlier_share: float
    mean_um: float
    """Mean residual along the light plane's normal."""
    rms_um: float
    """Of the pixels that are not outliers."""
    slope_um: float
    """Greatest linear trend of the residual over the field, end to end."""
    bend_um: float
    """Greatest curved trend."""
    height_mm: float | None
    """Estimated height of a flat; None for boards."""
    ok: bool
    cause: str
    map_um: F8
    """[h, w] residual; NaN where not used."""


@dataclass(frozen=True)
class PlaneResult:
    """A light plane from sweeps."""

    a: F8
    """[3] t per mm."""
    b: float
    covariance: F8
    """[4, 4] of (a, b); independent pixels assumed."""
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
        across = np.eye(3) - np.outer(self.normal, self.normal)
        spread = across @ self.covariance[:3, :3] @ across * self.speed_mm**2
        return float(np.degrees(np.sqrt(np.linalg.eigvalsh(spread).max())))

    @property
    def speed_sd(self) -> float:
        """Relative standard deviation of the speed."""
        return float(np.sqrt(self.normal @ self.covariance[:3, :3] @ self.normal)) * self.speed_mm

    @property
    def ok(self) -> bool:
        """All surfaces agree within LIMIT_UM."""
        return all(surface.ok for surface in self.surfaces)

    def validity(self, days: float) -> dict[str, Any]:
        """The ``valid_for`` object: the sweep that it was made with, and for how long it is meant."""
        plan = self.sweep.plan
        made = {"created_utc": utc_now(), "days": days}
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


def board_surface(sweep: FoldedSweep, board: Board, camera: CameraModel) -> Surface:
    """The board in the pose that its own corners in this sweep show; pixels clear of printed edges.

    Raises:
        CalibrationError: board not found, its pose ambiguous, or too few clean pixels.
    """
    try:
        sighting = find_board(sweep.picture, board)
    except CalibrationError as error:
        raise CalibrationError(f"{sweep.name}: {error}") from None
    matrix, distortion = np.array(camera.K), np.array(camera.distortion)
    pose = find_pose(sighting.object_mm, sighting.pixels, matrix, distortion)
    if pose.ambiguous:
        raise CalibrationError(f"{sweep.name}: two poses of the board explain it nearly equally; tilt it more")
    to_world = np.array(camera.R).T
    rotation = to_world @ pose.rotation
    point = to_world @ (pose.translation - np.array(camera.T))
    view = rays(camera)
    at = (_meet(view, point, rotation[:, 2], None) - point) @ rotation[:, :2]
    margin = min(BLUR_WIDTHS * BLUR_PX / sighting.pitch_px, MOST_OF_SQUARE)
    cells = (at - sighting.board_mm.min(axis=0)) / board.pitch_mm
    extent = np.ptp(sighting.board_mm, axis=0) / board.pitch_mm
    inside = ((cells > -1 + margin) & (cells < extent + 1 - margin)).all(axis=1)
    clear = (np.abs(cells - np.rint(cells)) > margin).all(axis=1)
    return Surface(sweep, point, rotation[:, 2], _chosen(sweep, inside & clear))


def flat_surface(sweep: FoldedSweep) -> Surface:
    """A matt white flat parallel to z = 0, its height free."""
    everywhere = np.ones(sweep.crossing.size, dtype=np.bool_)
    return Surface(sweep, np.zeros(3), np.array([0.0, 0.0, 1.0]), _chosen(sweep, everywhere), free_height=True)


def _chosen(sweep: FoldedSweep, allowed: NDArray[np.bool_]) -> NDArray[np.intp]:
    pixels = np.flatnonzero(allowed & np.isfinite(sweep.crossing.ravel()))
    if len(pixels) < MIN_PIXELS:
        raise CalibrationError(
            f"{sweep.name}: only {len(pixels)} clean pixels on the surface; {MIN_PIXELS} are needed: sweep all of it"
        )
    return pixels[:: max(len(pixels) // MOST_PIXELS, 1)]


def _meet(view: Rays, point: F8, normal: F8, pixels: NDArray[np.intp] | None) -> F8:
    directions = view.directions if pixels is None else view.directions[pixels]
    distance = (normal @ (point - view.centre_mm)) / (directions @ normal)
    return np.asarray(view.centre_mm + distance[:, None] * directions, dtype=np.float64)


def fit_plane(surfaces: Sequence[Surface], camera: CameraModel, *, edge: str, method: str) -> PlaneResult:
    """The light plane that explains the crossings on all surfaces.

    Args:
        surfaces: at least two that are not in one plane.
        camera: with its pose in the world.
        edge: ``rising`` or ``falling``, as the sweeps were folded.
        method: the crossing estimate they were folded with.

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
    results = _results(surfaces, points, heights, a, b)
    first = surfaces[0].sweep
    return PlaneResult(
        a, b, solution.covariance[:4, :4], first.parameter, edge, method, results, first, _speed_notes(a, first)
    )


def _points(surfaces: Sequence[Surface], heights: F8, view: Rays) -> list[F8]:
    return [
        _meet(view, surface.point + height * surface.normal, surface.normal, surface.pixels)
        for surface, height in zip(surfaces, heights, strict=True)
    ]


def _solve(surfaces: Sequence[Surface], points: Sequence[F8], view: Rays) -> robust.Solution:
    """One linear step: a, b, and the change of each free height (through the ray: dX/dh along the ray)."""
    free = [index for index, surface in enumerate(surfaces) if surface.free_height]
    x = np.concatenate(points)
    t = np.concatenate([surface.sweep.t.ravel()[surface.pixels] for surface in surfaces])
    sigma = np.concatenate([
        np.hypot(surface.sweep.sigma.ravel()[surface.pixels], FLOOR_FRAMES) * abs(surface.sweep.unit_per_frame)
        for surface in surfaces
    ])  # fmt: skip
    sigma = np.where(np.isfinite(sigma), sigma, np.nanmax(sigma))
    design = np.column_stack([x, np.ones(len(x))])
    if not free:
        return robust.solve(design, t, sigma)
    boards = [index for index in range(len(surfaces)) if index not in free]
    rows = np.concatenate([np.full(len(p), index) for index, p in enumerate(points)])
    on_boards = np.isin(rows, boards)
    # the height's effect needs a: taken from the boards, or from all where there are none
    a = robust.solve(design[on_boards], t[on_boards], sigma[on_boards]).x[:3] if on_boards.any() else None
    if a is None:
        raise CalibrationError("flats alone cannot show the tilt of the light plane: add a sweep over the board")
    lift = np.zeros((len(x), len(free)))
    for column, index in enumerate(free):
        own = rows == index
        directions = view.directions[surfaces[index].pixels]
        lift[own, column] = directions @ a / (directions @ surfaces[index].normal)
    return robust.solve(np.column_stack([design, lift]), t, sigma)


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
    middle = view.directions[len(view.directions) // 2]
    sine = abs(float(a @ middle)) / float(np.linalg.norm(a) * np.linalg.norm(middle))
    angle = float(np.degrees(np.arcsin(min(sine, 1.0))))
    if angle < MIN_RAY_ANGLE_DEG:
        raise CalibrationError(
            f"the light plane is parallel to the view rays within {angle:.1f} degrees: heights cannot be measured; "
            "tilt the projector"
        )


def _results(
    surfaces: Sequence[Surface], points: Sequence[F8], heights: F8, a: F8, b: float
) -> tuple[SurfaceResult, ...]:
    found = []
    for surface, x, height in zip(surfaces, points, heights, strict=True):
        shape = surface.sweep.crossing.shape
        residual = (surface.sweep.t.ravel()[surface.pixels] - x @ a - b) / float(np.linalg.norm(a)) * 1000
        middle = float(np.median(residual))
        scale = robust.MAD_TO_SIGMA * float(np.median(np.abs(residual - middle)))
        near = np.abs(residual - middle) <= 4 * max(scale, 1e-9)
        whole = np.full(shape[0] * shape[1], np.nan)
        whole[surface.pixels[near]] = residual[near]
        slope, bend = _trend(surface.pixels[near], residual[near], shape)
        mean = float(residual[near].mean())
        rms = float(np.sqrt((residual[near] ** 2).mean()))
        result = SurfaceResult(
            surface.sweep.name, int(near.sum()), float(1 - near.mean()), mean, rms,
            slope, bend, float(height) if surface.free_height else None, abs(mean) <= LIMIT_UM, "",
            whole.reshape(shape),
        )  # fmt: skip
        found.append(replace(result, cause=_cause(result)))
    return tuple(found)


def _trend(pixels: NDArray[np.intp], residual: F8, shape: tuple[int, ...]) -> tuple[float, float]:
    """Linear and curved trend of the residual over the field: greatest minus least in um."""
    y, x = np.divmod(pixels, shape[1])
    u, v = 2 * x / (shape[1] - 1) - 1, 2 * y / (shape[0] - 1) - 1
    linear = np.column_stack([u, v])
    curved = np.column_stack([u * u, u * v, v * v])
    curved = curved - curved.mean(axis=0)
    design = np.column_stack([np.ones(len(u)), linear, curved])
    fit = np.linalg.lstsq(design, residual, rcond=None)[0]
    return float(np.ptp(linear @ fit[1:3])), float(np.ptp(curved @ fit[3:]))


def _cause(result: SurfaceResult) -> str:
    """The probable cause of what the residual shows, in words; empty where nothing is wrong."""
    if result.bend_um > 2 * LIMIT_UM:
        return f"its residual is bent by {result.bend_um:.1f} um: lens distortion, a stage that is not straight, or a "\
            "board that is not flat"  # fmt: skip
    if result.slope_um > 4 * LIMIT_UM:
        return (
            f"its residual slopes by {result.slope_um:.1f} um: its pose is wrong (a board that moved during the sweep)"
        )
    if not result.ok:
        return f"it lies {result.mean_um:+.1f} um off the others: the board moved, the stage was homed, or lost steps"
    return ""


def _speed_notes(a: F8, sweep: FoldedSweep) -> tuple[str, ...]:
    per_unit_um = 1000.0 / float(np.linalg.norm(a))
    if sweep.parameter != "position_um":
        return ()
    notes = [f"the plane moves {per_unit_um:.4f} um along its normal per um of travel"]
    if per_unit_um > 1.02:
        notes.append("that is more than the stage travels: --square-mm or um_per_microstep is wrong")
    return tuple(notes)
