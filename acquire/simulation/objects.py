"""Objects on the simulated stage, as signed distances in mm (positive outside).

A stapes ("stirrup"), a spherical cap ("dome") and plates (flat, checkerboard, wedge). World axes as in ``optics``.
"""

# ruff: noqa: PLR0917 - kernels take their arrays and numbers by position

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from acquire.contract.config.simulation import SimulationConfig

from .kernels import F8, kernel
from .optics import PAPER_TRAVEL, Vector

STIRRUP, DOME, BOX = 0, 1, 2
STEP_SHARE = 0.85
"""Share of a signed distance that a ray may step: the stapes is warped, which stretches distances a little."""
FLAT_HALF_MM = (3.7, 2.8)
WEDGE_HALF_MM = (1.75, 0.72)
WEDGE_TILT_DEG = (3.0, -6.0)
"""The wedge's own tilt about x and y, added to the configured one: its right side is higher."""
WEDGE_LIFT_MM = 0.35
DOME_BASE_MM, DOME_HEIGHT_MM = 0.85, 0.45
NORMAL_STEP_MM = 1e-4


class ObjectForm(NamedTuple):
    """An object's form and pose; a named tuple of floats, as kernels take it."""

    kind: int
    """STIRRUP, DOME or BOX."""
    origin_mm: Vector
    """Origin of the local frame in the world: on the stage, or the middle of a plate's pattern."""
    rows: tuple[Vector, Vector, Vector]
    """Rows of the rotation from world to local axes."""
    size_mm: Vector
    """Half extents of a box; radius of a dome's sphere."""
    low_mm: Vector
    """Least corner of a box around the form, along the world's axes."""
    high_mm: Vector
    """Greatest corner of that box."""


def place_object(config: SimulationConfig) -> ObjectForm:
    """The configured object in its pose, shifted by ``specimen_moved_um``."""
    if config.object == "stirrup":
        return _stirrup_form(config)
    if config.object == "dome":
        return _dome_form(config)
    return _plate_form(config)


def _heading_deg() -> float:
    return math.degrees(math.atan2(PAPER_TRAVEL[1], PAPER_TRAVEL[0]))


def _stirrup_form(config: SimulationConfig) -> ObjectForm:
    local = np.array([[-2.1, -1.0, -0.05], [2.1, 1.0, 0.95]])
    return _form(config, STIRRUP, (0.0, 0.0, -config.board_thickness_mm), _turn(_heading_deg()), (0.0,) * 3, local)


def _dome_form(config: SimulationConfig) -> ObjectForm:
    radius = (DOME_BASE_MM**2 + DOME_HEIGHT_MM**2) / (2 * DOME_HEIGHT_MM)
    origin = (0.3, 0.0, DOME_HEIGHT_MM - radius - config.board_thickness_mm)
    reach = DOME_BASE_MM + 0.01
    local = np.array([[-reach, -reach, radius - DOME_HEIGHT_MM - 0.01], [reach, reach, radius + 0.01]])
    return _form(config, DOME, origin, np.eye(3), (radius, 0.0, 0.0), local)


def _plate_form(config: SimulationConfig) -> ObjectForm:
    """Flat, checkerboard and wedge: a slab with a tilted upper face; a tilted board rests on the stage."""
    tilt_x, tilt_y, yaw, lift = config.tilt_x_deg, config.tilt_y_deg, config.yaw_deg, 0.0
    thickness = config.board_thickness_mm
    half = FLAT_HALF_MM
    square = config.board_square_mm
    if config.object == "checkerboard":
        half = ((config.board_columns / 2 + 1) * square, (config.board_rows / 2 + 1) * square)
    if config.object == "wedge":
        half, yaw = WEDGE_HALF_MM, yaw + _heading_deg()
        tilt_x, tilt_y = tilt_x + WEDGE_TILT_DEG[0], tilt_y + WEDGE_TILT_DEG[1]
        lift, thickness = WEDGE_LIFT_MM - thickness, 2.0
    # yaw first, then the tilts about the world's axes: a tilt means the same however the plate is turned
    rotation = _turn(0.0, tilt_y) @ _turn(0.0, 0.0, tilt_x) @ _turn(yaw)
    # lifted so far that its lowest corner touches the stage
    if config.object != "wedge":
        lift = abs(rotation[2, 0]) * half[0] + abs(rotation[2, 1]) * half[1]
    size = (half[0], half[1], thickness / 2)
    local = np.array([[-half[0], -half[1], -thickness], [half[0], half[1], 0.0]])
    return _form(config, BOX, (0.0, 0.0, lift), rotation, size, local)


def _form(config: SimulationConfig, kind: int, origin: Vector, rotation: F8, size: Vector, local: F8) -> ObjectForm:
    """Pose a form by its local-to-world rotation and box it in; ``local`` [2, 3] is its box in local axes."""
    place = np.array(origin) + np.array(config.specimen_moved_um) / 1000
    corners = np.array([[local[i, 0], local[j, 1], local[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    world = corners @ rotation.T + place
    low, high = world.min(axis=0) - 1e-3, world.max(axis=0) + 1e-3
    # the inverse of a rotation is its transpose: rows that turn the world into local axes
    rows = tuple(_floats(row) for row in rotation.T)
    return ObjectForm(kind, _floats(place), rows, size, _floats(low), _floats(high))  # type: ignore[arg-type]


def _floats(values: F8) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _turn(about_z_deg: float, about_y_deg: float = 0.0, about_x_deg: float = 0.0) -> F8:
    """Right-handed rotation Rz Ry Rx, shape [3, 3]."""
    (cz, sz), (cy, sy), (cx, sx) = (
        (math.cos(math.radians(angle)), math.sin(math.radians(angle)))
        for angle in (about_z_deg, about_y_deg, about_x_deg)
    )
    about_z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    rotation: F8 = about_z @ about_y @ about_x
    return rotation


@kernel
def to_local(form: ObjectForm, x: float, y: float, z: float) -> Vector:
    """Coordinates of a point of the world in the form's own frame."""
    a, b, c = x - form.origin_mm[0], y - form.origin_mm[1], z - form.origin_mm[2]
    r0, r1, r2 = form.rows
    return (
        r0[0] * a + r0[1] * b + r0[2] * c,
        r1[0] * a + r1[1] * b + r1[2] * c,
        r2[0] * a + r2[1] * b + r2[2] * c,
    )


@kernel
def signed_distance(form: ObjectForm, x: float, y: float, z: float) -> float:
    """Distance in mm of a point of the world from the surface, negative inside (a lower bound of it outside)."""
    u, v, w = to_local(form, x, y, z)
    if form.kind == STIRRUP:
        return _stirrup(u, v, w)
    if form.kind == DOME:
        return math.sqrt(u * u + v * v + w * w) - form.size_mm[0]
    return _box(u, v, w + form.size_mm[2], form.size_mm[0], form.size_mm[1], form.size_mm[2])


@kernel
def surface_normal(form: ObjectForm, x: float, y: float, z: float) -> Vector:
    """Unit normal by central differences over 0.2 um, pointing outward."""
    h = NORMAL_STEP_MM
    a = signed_distance(form, x + h, y, z) - signed_distance(form, x - h, y, z)
    b = signed_distance(form, x, y + h, z) - signed_distance(form, x, y - h, z)
    c = signed_distance(form, x, y, z + h) - signed_distance(form, x, y, z - h)
    length = math.sqrt(a * a + b * b + c * c)
    return a / length, b / length, c / length


@kernel
def _box(u: float, v: float, w: float, half_u: float, half_v: float, half_w: float) -> float:
    a, b, c = abs(u) - half_u, abs(v) - half_v, abs(w) - half_w
    outside = math.sqrt(max(a, 0.0) ** 2 + max(b, 0.0) ** 2 + max(c, 0.0) ** 2)
    return outside + min(max(a, b, c), 0.0)


@kernel
def _rounded(a: float, b: float, half_a: float, half_b: float, radius: float) -> float:
    """A rectangle with round corners in two dimensions."""
    p, q = abs(a) - half_a + radius, abs(b) - half_b + radius
    return math.sqrt(max(p, 0.0) ** 2 + max(q, 0.0) ** 2) + min(max(p, q), 0.0) - radius


@kernel
def _blend(a: float, b: float, radius: float) -> float:
    """Union of two distances with a fillet."""
    # polynomial smooth minimum: a fillet where both distances differ by less than the radius
    h = max(radius - abs(a - b), 0.0) / radius
    return min(a, b) - h * h * radius * 0.25


@kernel
def _arch(u: float, v: float, w: float) -> float:
    """Two crura that meet in an arch at u = -1.1, bow outward and end in the footplate."""
    # a warped torus: the spread of the crura grows along u, so distances are stretched a little (STEP_SHARE)
    bow = min(max(u + 0.36, 0.0), 2.2)
    spread = v / (1.0 + 0.16 * bow - 0.045 * bow * bow)
    along = min(u + 0.42, 0.0)
    ring = math.sqrt(along * along + spread * spread) - 0.48
    thickness = 0.205 + 0.012 * min(max(u, -1.0), 2.0) ** 2
    tube = _rounded(ring, w - 0.34 - 0.02 * u, thickness, 0.27, 0.19)
    return max(tube, u - 1.72)


@kernel
def _head(u: float, v: float, w: float) -> float:
    """The knob that meets the next bone, and its neck."""
    across = v - min(max(v, -0.17), 0.13)
    knob = math.sqrt((u + 1.62) ** 2 + across * across + 1.1 * (w - 0.37) ** 2) - 0.37
    along = min(max((u + 1.55) / 0.75, 0.0), 1.0)
    neck = math.sqrt((u + 1.55 - 0.75 * along) ** 2 + v * v + (w - 0.35) ** 2) - 0.30
    return _blend(knob, neck, 0.2)


@kernel
def _footplate(u: float, v: float, w: float) -> float:
    """An upright oval plate."""
    a, b = _rounded(v, w - 0.37, 0.86, 0.37, 0.27) + 0.11, abs(u - 1.80) - 0.06
    return math.sqrt(max(a, 0.0) ** 2 + max(b, 0.0) ** 2) + min(max(a, b), 0.0) - 0.11


@kernel
def _stirrup(u: float, v: float, w: float) -> float:
    """A stapes, lying: head on the left, two crura around a hole, footplate on the right; 4 mm long."""
    # a slight bend, so that the bone is not symmetric
    bent = v + 0.05 * math.sin(1.4 * u + 0.6)
    return _blend(_blend(_arch(u, bent, w), _head(u, bent, w), 0.22), _footplate(u, v, w), 0.16)
