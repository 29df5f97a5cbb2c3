"""Ray casting: the surface that each pixel sees, and when the projector's light reaches it. Lengths in mm."""

# ruff: noqa: PLR0917 - kernels take their arrays and numbers by position

from __future__ import annotations

import math

import numpy as np

from .kernels import F4, F8, Bits, Mask, kernel
from .objects import STEP_SHARE, ObjectForm, signed_distance, surface_normal
from .optics import Projector, Vector, lit_interval

HIT_MM = 1e-7
MAX_WALK = 200
SHADOW_START_MM = 4e-3
"""A shadow ray starts so far from its surface, else it would hit that surface."""
SHADOW_HIT_MM = 2e-4
VISIBILITY_SAMPLES = 64
VISIBILITY_STRIDE = 16
"""Samples between two coarse shadow rays, before bisection; a shadow moves by some 0.05 mm in between."""


@kernel
def box_interval(low: Vector, high: Vector, start: Vector, direction: Vector) -> tuple[float, float]:
    """Path lengths at which a ray enters and leaves a box along the axes; enter > leave: it misses."""
    enter, leave = 0.0, np.inf
    for axis in range(3):
        # parallel to these two faces: no division by zero
        if direction[axis] == 0.0:
            if start[axis] < low[axis] or start[axis] > high[axis]:
                return np.inf, -np.inf
            continue
        a = (low[axis] - start[axis]) / direction[axis]
        b = (high[axis] - start[axis]) / direction[axis]
        enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
    return enter, leave


@kernel
def walk_to_surface(form: ObjectForm, start: Vector, direction: Vector) -> float:
    """Path length to the form's surface by sphere tracing; infinite where the ray misses it."""
    at, leave = box_interval(form.low_mm, form.high_mm, start, direction)
    for _ in range(MAX_WALK):
        if at > leave:
            break
        distance = signed_distance(
            form, start[0] + at * direction[0], start[1] + at * direction[1], start[2] + at * direction[2]
        )
        if distance < HIT_MM:
            return at
        # sphere tracing: no surface is nearer than the signed distance
        at += distance * STEP_SHARE
    return np.inf


@kernel
def is_blocked(form: ObjectForm, x: float, y: float, z: float, apex: Vector) -> bool:
    """True when the form lies between a point of a surface and the projector's apex."""
    a, b, c = apex[0] - x, apex[1] - y, apex[2] - z
    length = math.sqrt(a * a + b * b + c * c)
    direction = (a / length, b / length, c / length)
    at, leave = box_interval(form.low_mm, form.high_mm, (x, y, z), direction)
    at = max(at, SHADOW_START_MM)
    for _ in range(MAX_WALK):
        if at > leave:
            return False
        distance = signed_distance(form, x + at * direction[0], y + at * direction[1], z + at * direction[2])
        if distance < SHADOW_HIT_MM:
            return True
        at += distance * STEP_SHARE
    return True


@kernel
def see_surfaces(
    form: ObjectForm, stage_z_mm: float, centre: F8, rays: F8, points: F8, normals: F8, on_object: Mask
) -> None:
    """Fill points [n, 3] in mm, outward normals [n, 3] and on_object [n] for rays [n, 3] from the camera's centre."""
    start = (centre[0], centre[1], centre[2])
    for i in range(rays.shape[0]):
        direction = (rays[i, 0], rays[i, 1], rays[i, 2])
        at = (stage_z_mm - start[2]) / direction[2]
        found = walk_to_surface(form, start, direction)
        # the nearer one of object and stage; the stage is a plane and needs no walk
        on_object[i] = found < at
        at = min(at, found)
        for axis in range(3):
            points[i, axis] = start[axis] + at * direction[axis]
        if on_object[i]:
            normals[i] = surface_normal(form, points[i, 0], points[i, 1], points[i, 2])
        else:
            normals[i] = (0.0, 0.0, 1.0)


@kernel
def apex_at(projector: Projector, position_steps: float) -> Vector:
    """The projector's apex in mm when the stage stands at a position."""
    return (
        projector.apex_mm[0] + position_steps * projector.step_mm[0],
        projector.apex_mm[1] + position_steps * projector.step_mm[1],
        projector.apex_mm[2] + position_steps * projector.step_mm[2],
    )


@kernel
def _free(form: ObjectForm, projector: Projector, x: float, y: float, z: float, position_steps: float) -> bool:
    return not is_blocked(form, x, y, z, apex_at(projector, position_steps))


@kernel
def visibility_bits(
    form: ObjectForm, projector: Projector, x: float, y: float, z: float, first_steps: float, pitch_steps: float
) -> np.uint64:
    """Bit j is set if light reaches the point at stage position first_steps + j pitch_steps."""
    # coarse samples, then bisection between two that differ: a shadow ray is far more expensive than a comparison
    bits = np.uint64(0)
    low, low_free = 0, _free(form, projector, x, y, z, first_steps)
    if low_free:
        bits |= np.uint64(1)
    while low < VISIBILITY_SAMPLES - 1:
        high = min(low + VISIBILITY_STRIDE, VISIBILITY_SAMPLES - 1)
        high_free = _free(form, projector, x, y, z, first_steps + high * pitch_steps)
        change = high
        if low_free != high_free:
            # at most one change between two coarse samples is assumed (VISIBILITY_STRIDE)
            below = low
            while change - below > 1:
                middle = (below + change) // 2
                if _free(form, projector, x, y, z, first_steps + middle * pitch_steps) == low_free:
                    below = middle
                else:
                    change = middle
        for j in range(low + 1, high + 1):
            if low_free if j < change else high_free:
                bits |= np.uint64(1) << np.uint64(j)
        low, low_free = high, high_free
    return bits


@kernel
def find_shadows(
    form: ObjectForm,
    projector: Projector,
    points: F8,
    crossing: F8,
    width: F8,
    facing: F4,
    before_steps: float,
    pitch_steps: float,
    sigmas: float,
    bits: Bits,
) -> None:
    """Fill bits [n]: visibility from ``before_steps`` ahead of each pixel's crossing, every ``pitch_steps``.

    Pixels that face away, or that the slide's opening never reaches, get 0.
    """
    for i in range(points.shape[0]):
        bits[i] = np.uint64(0)
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        first, last = lit_interval(projector, x, y, z, crossing[i], width[i], -sigmas)
        if facing[i] > 0 and first < last:
            bits[i] = visibility_bits(form, projector, x, y, z, crossing[i] - before_steps, pitch_steps)


@kernel
def visible_share(bits: np.uint64, relative_steps: float, before_steps: float, pitch_steps: float) -> float:
    """Share 0..1 of the light that shadows leave ``relative_steps`` after the crossing, linear between samples."""
    at = (relative_steps + before_steps) / pitch_steps
    at = min(max(at, 0.0), VISIBILITY_SAMPLES - 1.001)
    low = int(at)
    share = at - low
    a = float((bits >> np.uint64(low)) & np.uint64(1))
    b = float((bits >> np.uint64(low + 1)) & np.uint64(1))
    return a + share * (b - a)
