"""Camera and projector of the simulated rig: the paper's geometry (equations 1 to 15), exact, in mm.

World: x to the right and y up in the picture, z up toward the camera, z = 0 the pattern of the board lying flat. The
projector stands on the left and sweeps to the right, as in the pictures of the paper. The paper's printed normal and
corner track (equations 14 and 15) belong to its listings' convention, with x mirrored: their x components have the
other sign here. Positions of the stage are in microsteps.
"""

# ruff: noqa: PLR0917 - kernels take their arrays and numbers by position

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from acquire.contract.config.simulation import SimulationConfig

from .kernels import F8, kernel

FULL_WIDTH, FULL_HEIGHT = 1024, 768
"""Image size of the paper's camera; other sizes see the same field with other pixels."""
# equations 11, 12, 14 and 15
PAPER_FOCAL_PX = (11560.0, 11530.0)
PAPER_PRINCIPAL_PX = (692.1, 591.6)
PAPER_ROTATION = ((0.9998, 0.001851, 0.02065), (-0.002296, 0.9998, 0.02157), (-0.02061, -0.02162, 0.9996))
PAPER_NORMAL = (0.5461, -0.0055, 0.8377)
PAPER_TRAVEL = (0.00939, 0.00087, 0.0)
LENS_FOCAL_MM = 50.0
"""f of equation 5."""
LENS_TO_SLIDE_MM = 102.32
"""xb of the paper's listings."""
CORNER_MIDWAY_MM = (0.0, 0.9, 0.0)
"""Where the corner of the pattern meets z = 0 half-way through the sweep of the paper."""
HALF_SWEEP_MM = 789 * 3.175e-3
FOCUS_HEIGHT_MM = 0.0
EDGE_SIGMAS = 5.0
"""Beyond so many standard deviations of the blur an edge counts as dark or fully lit (error below 3e-7)."""

Vector = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class PinholeCamera:
    """Pinhole with OpenCV's distortion: X_cam = R X + T (equation 1), pixel centres at integers."""

    width: int
    height: int
    matrix: F8
    distortion: F8
    rotation: F8
    translation: F8

    @property
    def centre_mm(self) -> F8:
        """u = -R^T T of equation 2, shape [3]."""
        return -self.rotation.T @ self.translation

    def rays(self) -> F8:
        """Unit directions v = R^T K^-1 p' (equation 2) of all pixels in the world, undistorted, shape [h, w, 3]."""
        x = (np.arange(self.width) - self.matrix[0, 2]) / self.matrix[0, 0]
        y = (np.arange(self.height) - self.matrix[1, 2]) / self.matrix[1, 1]
        plane = self._undistorted(*np.meshgrid(x, y))
        rays = np.concatenate([plane, np.ones_like(plane[..., :1])], axis=-1) @ self.rotation
        directions: F8 = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        return directions

    def _undistorted(self, x: F8, y: F8) -> F8:
        """Invert k1 k2 p1 p2 k3 by fixed-point iteration; for a small distortion ten rounds reach rounding error."""
        k1, k2, p1, p2, k3 = self.distortion
        a, b = x.copy(), y.copy()
        for _ in range(10):
            r2 = a * a + b * b
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            da = 2 * p1 * a * b + p2 * (r2 + 2 * a * a)
            db = p1 * (r2 + 2 * b * b) + 2 * p2 * a * b
            a, b = (x - da) / radial, (y - db) / radial
        return np.stack([a, b], axis=-1)


class Projector(NamedTuple):
    """The slide projector at stage position 0, and its motion; a named tuple of floats, as kernels take it."""

    corner_mm: Vector
    """Corner c of the quarter circle on z = 0, at position 0."""
    apex_mm: Vector
    """Lens centre F at position 0: xf from the corner c, against the optical axis (equation 9)."""
    normal: Vector
    """Unit normal of the leading light plane, z up; points where n . (X - c) < 0 are lit."""
    edge: Vector
    """Unit direction e1 of the leading edge on the floor (6 o'clock, -y): the lit side of the other straight edge."""
    axis: Vector
    """Unit direction of the optical axis, from F to c."""
    step_mm: Vector
    """Displacement of the projector per microstep."""
    radius_ratio: float
    """hp / xf = hs / f: tangent of the half angle of the cone whose quarter is lit."""
    focus_mm: float
    """Distance from F along the axis where the slide is in focus."""
    best_width_steps: float
    """Blur at best focus, standard deviation in microsteps of travel."""
    defocus_steps_per_mm: float
    """Growth of the blur with the distance from the focus."""

    @property
    def normal_step_mm(self) -> float:
        """Travel of the light plane along its normal per microstep, in mm."""
        return float(np.dot(self.normal, self.step_mm))


def paper_camera(config: SimulationConfig, width: int, height: int) -> PinholeCamera:
    """The paper's camera (equations 11 and 12), with the world's origin in the middle of a picture of any size."""
    # pixel centres at integers: the principal point scales about -0.5
    sx, sy = width / FULL_WIDTH, height / FULL_HEIGHT
    matrix = np.array(
        [
            [PAPER_FOCAL_PX[0] * sx, 0.0, (PAPER_PRINCIPAL_PX[0] + 0.5) * sx - 0.5],
            [0.0, PAPER_FOCAL_PX[1] * sy, (PAPER_PRINCIPAL_PX[1] + 0.5) * sy - 0.5],
            [0.0, 0.0, 1.0],
        ]
    )
    # printed with four digits R is not quite a rotation: take the nearest one, then turn it to our axes
    left, _, right = np.linalg.svd(np.array(PAPER_ROTATION))
    rotation = (left @ right) @ np.diag([1.0, -1.0, -1.0])
    # T such that the world's origin projects to the middle of the picture
    middle = np.linalg.solve(matrix, [(width - 1) / 2, (height - 1) / 2, 1.0])
    distance_mm = config.camera_distance_mm
    return PinholeCamera(width, height, matrix, np.array(config.distortion), rotation, middle * distance_mm)


def paper_projector(config: SimulationConfig, um_per_microstep: float) -> Projector:
    """The paper's projector (hs, f, xb; equations 5 to 10, 14), placed so that 0..1578 microsteps cover the field."""
    normal = np.array(PAPER_NORMAL) / np.linalg.norm(PAPER_NORMAL)
    travel = np.array(PAPER_TRAVEL) / np.linalg.norm(PAPER_TRAVEL)
    # the leading edge is where the light plane meets z = 0; the optical axis lies in the light plane, at right angles
    edge = np.cross(normal, [0.0, 0.0, 1.0])
    edge /= np.linalg.norm(edge)
    axis = np.cross(normal, edge)
    # corner(t) of equation 15, shifted so that the middle of the sweep lies in the middle of the picture
    corner = np.array(CORNER_MIDWAY_MM) - travel * HALF_SWEEP_MM
    pattern_radius_mm = config.slide_radius_mm * LENS_FOCAL_MM / LENS_TO_SLIDE_MM
    apex_distance_mm = LENS_FOCAL_MM * pattern_radius_mm / config.slide_radius_mm
    return Projector(
        corner_mm=_vector(corner),
        apex_mm=_vector(corner - apex_distance_mm * axis),
        normal=_vector(normal),
        edge=_vector(edge),
        axis=_vector(axis),
        step_mm=_vector(travel * um_per_microstep / 1000),
        radius_ratio=config.slide_radius_mm / LENS_FOCAL_MM,
        focus_mm=apex_distance_mm + FOCUS_HEIGHT_MM / float(axis[2]),
        best_width_steps=config.edge_width_um / um_per_microstep,
        defocus_steps_per_mm=config.defocus_um_per_mm / um_per_microstep,
    )


def _vector(values: F8) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z


@kernel
def dot(a: Vector, b: Vector) -> float:
    """Scalar product of two 3-tuples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def slide_coordinates(projector: Projector, x: float, y: float, z: float, position_steps: float) -> Vector:
    """Distances in mm of a point: behind the leading plane, behind the other edge, and from F along the axis."""
    at = (
        x - projector.apex_mm[0] - position_steps * projector.step_mm[0],
        y - projector.apex_mm[1] - position_steps * projector.step_mm[1],
        z - projector.apex_mm[2] - position_steps * projector.step_mm[2],
    )
    return -dot(projector.normal, at), dot(projector.edge, at), dot(projector.axis, at)


@kernel
def normal_cdf(x: float) -> float:
    """Cumulative normal distribution."""
    return 0.5 * math.erfc(-x * math.sqrt(0.5))


@kernel
def lit_fraction(
    projector: Projector, x: float, y: float, z: float, position_steps: float, width_steps: float
) -> float:
    """Share 0..1 of the lamp's light that the slide lets through to a point: three blurred edges, without shadows."""
    lead, side, depth = slide_coordinates(projector, x, y, z, position_steps)
    sigma_mm = width_steps * dot(projector.normal, projector.step_mm)
    cosine = 1.0 / math.sqrt(1.0 + projector.radius_ratio**2)
    # distance within the cone of the arc, measured square to its surface
    arc = (projector.radius_ratio * depth - math.sqrt(lead * lead + side * side)) * cosine
    return normal_cdf(lead / sigma_mm) * normal_cdf(side / sigma_mm) * normal_cdf(arc / sigma_mm)


@kernel
def arc_interval(projector: Projector, x: float, y: float, z: float, inside_mm: float) -> tuple[float, float]:
    """Stage positions between which a point is at least ``inside_mm`` within the full cone; (inf, -inf) for never."""
    lead, side, depth = slide_coordinates(projector, x, y, z, 0.0)
    per_lead = dot(projector.normal, projector.step_mm)
    per_side = -dot(projector.edge, projector.step_mm)
    ratio = projector.radius_ratio
    reach = ratio * depth - inside_mm * math.sqrt(1.0 + ratio * ratio)
    per_reach = -ratio * dot(projector.axis, projector.step_mm)
    # all three distances are linear in the position, so the cone's surface is a quadratic a s^2 + 2 b s + c = 0
    a = per_reach**2 - per_lead**2 - per_side**2
    b = reach * per_reach - lead * per_lead - side * per_side
    c = reach**2 - lead**2 - side**2
    root = b * b - a * c
    # no real solution: the cone passes by the point; a >= 0: the motion is along the cone, not across it
    if root <= 0 or a >= 0:
        return np.inf, -np.inf
    # a < 0: the point is within the cone between both roots; of the double cone only the half with reach > 0 is lit
    first, last = (-b + math.sqrt(root)) / a, (-b - math.sqrt(root)) / a
    if reach + per_reach * 0.5 * (first + last) <= 0:
        return np.inf, -np.inf
    return first, last


@kernel
def lit_interval(
    projector: Projector, x: float, y: float, z: float, crossing_steps: float, width_steps: float, sigmas: float
) -> tuple[float, float]:
    """Stage positions between which a point is ``sigmas`` blurs inside all edges (negative: at most so far outside)."""
    inside_mm = sigmas * width_steps * dot(projector.normal, projector.step_mm)
    first, last = arc_interval(projector, x, y, z, inside_mm)
    first = max(first, crossing_steps + sigmas * width_steps)
    _, side, _ = slide_coordinates(projector, x, y, z, 0.0)
    per_side = -dot(projector.edge, projector.step_mm)
    if per_side > 0:
        first = max(first, (inside_mm - side) / per_side)
    elif per_side < 0:
        last = min(last, (inside_mm - side) / per_side)
    elif side < inside_mm:
        last = -np.inf
    return first, last
