"""The light plane from sweeps over known surfaces: t = a . X + b for all of them, and its uncertainty.

For a plane that only translates, the crossing coordinate t is affine in the point X (docs/design.md, section 5): the
normal is n = a / |a|, and the plane moves 1 / |a| along n per unit of t. This replaces equations 5 to 10 and 15 of the
paper: nothing is clicked, and the residuals show how good it is. A velocity within the plane cannot be seen, and does
not matter for points. Lengths in mm, t in um of travel or frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import CameraModel
from acquire.contract.errors import CalibrationError
from process.calibration.calibration_file import utc_now
from process.cloud.triangulation import Rays, rays

from .joint import Joint, solve_jointly
from .plane_residuals import SurfaceResult, surface_results
from .surfaces import Surface, meet
from .sweeps import FoldedSweep
from .uncertainty import Spread, predicted_um

F8 = NDArray[np.float64]
MIN_THICKNESS_MM = 0.03
"""Least spread of the surfaces' points off their common plane,"""
MIN_THICKNESS_SHARE = 0.04
"""or, where that is less, this share of their spread within it: small boards are told apart by less."""
MIN_RAY_ANGLE_DEG = 5.0
GOOD_UM = 10.0
"""Predicted error of a point beyond which more sweeps are advised."""
SMALL_SHARE = 0.5
"""Share of the picture: where the boards cover less, a note gives the predicted error."""
CAMERA = 15
LIGHT = slice(15, 19)
"""Elements of the joint covariance: the first 15 for intrinsics and stage, then (a, b)."""


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
    notes: tuple[str, ...]
    camera: CameraModel
    """Refined by the sweeps: these show the board too, and tie its poses to each other."""
    camera_covariance: F8
    """[15, 15] of its intrinsics and the world's pose; zero where the camera was taken as exact."""
    predicted_um: tuple[float, ...]
    """Standard deviation of a point at the corners of the field, on the stage and half a millimetre above."""

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
        """The same from the covariance [4, 4] of one source."""
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
        """The ``valid_for`` object of calibration.json: the plan of the sweeps, and the days it is meant to be used."""
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

    def lines(self) -> list[str]:
        """The result as lines of text."""
        lines = [
            f"{s.name}: {s.pixels} pixels, mean residual {s.mean_um:+.2f} um, RMS {s.rms_um:.2f} um, "
            f"trend {s.slope_um:.2f} um, bend {s.bend_um:.2f} um, {100 * s.outlier_share:.0f} % left out"
            + ("" if s.height_mm is None else f", height {s.height_mm:.4f} mm")
            + ("" if s.board_shift is None else f", {s.board_shift.um:.2f} um from where its corners alone put it")
            + (f": {s.cause}" if s.cause else "")
            for s in self.surfaces
        ]
        n = self.normal
        unit = "um of travel" if self.parameter == "position_um" else "frame"
        lines.append(
            f"normal ({n[0]:.5f}, {n[1]:.5f}, {n[2]:.5f}) +- {self.normal_sd_deg:.4f} degrees, "
            f"{1000 * self.speed_mm:.5f} um along it per {unit} +- {100 * self.speed_sd:.4f} %"
        )
        parts = ", ".join(f"{name} {value:.4f}" for name, value in self.normal_sd_parts_deg.items())
        lines.append(f"the normal's standard deviation by source, degrees: {parts}")
        lines.append(
            f"predicted error of a point at the corners of the field: {self.predicted_um[0]:.2g} um on the stage, "
            f"{self.predicted_um[1]:.2g} um half a millimetre above (standard deviations, all together)"
        )
        lines.append("commanded speed: not determinable, sweeps show the motion along the normal only")
        return lines + [f"note: {note}" for note in self.notes]

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
                "predicted_um": {"at_z0": self.predicted_um[0], "at_half_mm": self.predicted_um[1]},
                "commanded_speed": "not determinable: sweeps show the motion along the normal only",
                "surfaces": [
                    {
                        "name": s.name, "pixels": s.pixels, "outlier_share": s.outlier_share, "mean_um": s.mean_um,
                        "rms_um": s.rms_um, "slope_um": s.slope_um, "bend_um": s.bend_um, "height_mm": s.height_mm,
                        "moved_um": None if s.board_shift is None else s.board_shift.um,
                        "moved_chi2": None if s.board_shift is None else s.board_shift.chi2,
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
    """Fit the light plane to the crossings on all surfaces.

    Args:
        surfaces: at least two that are not in one plane.
        camera: with its pose in the world.
        edge: ``rising`` or ``falling``, as the sweeps were folded.
        method: the crossing estimate they were folded with.
        known_camera: covariance [15, 15] of the camera's intrinsics and pose; None where it is not known.

    Raises:
        CalibrationError: sweeps in different units, surfaces in one plane, a plane along the view rays, a board whose
            two poses explain everything nearly equally.
    """
    if len({surface.sweep.parameter for surface in surfaces}) != 1:
        raise CalibrationError("some sweeps know their stage positions and some do not: use sweeps of one kind")
    _refuse_one_plane(surfaces, rays(camera))
    joint = solve_jointly(surfaces, camera, known_camera)
    view, a, b = rays(joint.camera), joint.light[:3], float(joint.light[3])
    _refuse_grazing(a, view)
    points = [
        meet(view, surface.point + height * surface.normal, surface.normal, surface.pixels)
        for surface, height in zip(joint.surfaces, joint.heights, strict=True)
    ]
    results = surface_results(joint.surfaces, points, joint.heights, a, b, joint.shifts)
    parts = (joint.covariance(name)[LIGHT, LIGHT] for name in ("pixels", "poses", "camera"))
    values = joint.camera_and_light_of(joint.state)
    predicted = predicted_um(values, joint.covariance(), (camera.width, camera.height))
    return PlaneResult(
        a, b, Spread(*parts), surfaces[0].sweep.parameter, edge, method, results, surfaces[0].sweep,
        _notes(joint, predicted), joint.camera, joint.covariance()[:CAMERA, :CAMERA], predicted,
    )  # fmt: skip


def _refuse_one_plane(surfaces: Sequence[Surface], view: Rays) -> None:
    known = [meet(view, s.point, s.normal, s.pixels) for s in surfaces if not s.free_height]
    if not known:
        raise CalibrationError("flats alone cannot show the tilt of the light plane: add a sweep over the board")
    every = np.concatenate(known)
    sizes = np.linalg.svd(every - every.mean(axis=0), compute_uv=False) / np.sqrt(len(every))
    spread = float(sizes[-1])
    if spread < min(MIN_THICKNESS_MM, MIN_THICKNESS_SHARE * float(sizes[1])):
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


def _notes(joint: Joint, predicted: tuple[float, ...]) -> tuple[str, ...]:
    surfaces, notes = joint.problem.surfaces, []
    notes += _speed_notes(joint.light[:3], surfaces[0].sweep)
    if len({surface.sweep.zero_id for surface in surfaces if surface.sweep.zero_id}) > 1:
        notes.append("the stage was homed between the sweeps: they count from different zeros, take them in one go")
    if joint.problem.known_camera is None:
        notes.append("the camera's file does not say how uncertain it is: the standard deviations leave it out")
    if joint.problem.flat_boards:
        names = ", ".join(surfaces[index].sweep.name for index in joint.problem.flat_boards)
        notes.append(f"{names} lies flat on the stage as far as its corners tell: z = 0 is its pattern as well")
    if joint.contradicts:
        notes.append(
            f"corners, light and camera contradict each other by {np.sqrt(joint.contradiction):.1f} times what their "
            "noise allows: the standard deviations are made larger by as much"
        )
    return (*notes, *_small_notes(joint, predicted))


def _small_notes(joint: Joint, predicted: tuple[float, ...]) -> list[str]:
    """Notes on boards that cover little of the field, and on which sweeps would help."""
    widest, notes = max(_share(surface) for surface in joint.problem.surfaces), []
    if widest < SMALL_SHARE:
        notes.append(
            f"the boards cover {100 * widest:.0f} % of the field at most: predicted error of a point at the corners of "
            f"the field {predicted[0]:.1f} um on the stage, {predicted[1]:.1f} um half a millimetre above"
        )
    if max(predicted) > GOOD_UM and not joint.contradicts:
        flat_boards = joint.problem.flat_boards or joint.problem.flats
        missing = "tilted by 20 degrees in other directions" if flat_boards else "lying flat on the stage"
        notes.append(
            f"more than {GOOD_UM:g} um are predicted: add sweeps over the board {missing}, or take a larger one"
        )
    return notes


def _share(surface: Surface) -> float:
    """Share of the picture that the surface's pixels span."""
    height, width = surface.sweep.crossing.shape
    row, column = np.divmod(surface.pixels, width)
    return float((np.ptp(row) + 1) * (np.ptp(column) + 1)) / (height * width)


def _speed_notes(a: F8, sweep: FoldedSweep) -> list[str]:
    per_unit_um = 1000.0 / float(np.linalg.norm(a))
    if sweep.parameter != "position_um":
        return []
    notes = [f"the plane moves {per_unit_um:.4f} um along its normal per um of travel"]
    if per_unit_um > 1.02:
        notes.append("that is more than the stage travels: --square-mm or um_per_microstep is wrong")
    return notes
