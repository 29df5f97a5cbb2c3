"""Appearance of surfaces: albedo, fine relief and room light of bone, matt white, board and black foil.

Points in mm in the world; albedo is linear RGB, 0..1.
"""

# ruff: noqa: PLR0917 - kernels take their arrays and numbers by position

from __future__ import annotations

import math

import numpy as np

from .kernels import F4, F8, Mask, kernel
from .noise import mix64, value_noise
from .objects import ObjectForm, signed_distance, to_local
from .optics import Vector

FOIL, BONE, WHITE, BOARD = 0, 1, 2, 3
FOIL_ALBEDO = (0.105, 0.105, 0.112)
BONE_ALBEDO = (0.87, 0.775, 0.635)
BONE_STAIN = (0.60, 0.38, 0.24)
WHITE_ALBEDO = (0.82, 0.815, 0.80)
BLACK_ALBEDO = 0.05
BOARD_BLUR_SHARE = 1.0
"""Width of a printed square's edge in the picture, in pixels: a pixel averages over its area, so no edge is narrower.
(A narrower one, sampled at the pixels' middles only, would move corners by up to 0.1 px.)"""
OCCLUSION_REACH_MM = (0.06, 0.15, 0.35)


@kernel
def _checks(
    form: ObjectForm, x: float, y: float, z: float, square_mm: float, columns: int, rows: int, pixel_mm: float
) -> float:
    """Share of white 0..1 at a point of the board, each edge softened over about a pixel."""
    u, v, w = to_local(form, x, y, z)
    # the sides and the back of the board are white
    if w < -1e-3:
        return 1.0
    soft = BOARD_BLUR_SHARE * pixel_mm / square_mm
    column_wave, column_cover = _square_wave(u / square_mm + columns / 2, soft, columns)
    row_wave, row_cover = _square_wave(v / square_mm + rows / 2, soft, rows)
    return 1.0 - column_cover * row_cover * (0.5 + 0.5 * column_wave * row_wave)


@kernel
def _square_wave(at: float, soft: float, cells: int) -> tuple[float, float]:
    """+1 in even cells, -1 in odd ones, and the share 0..1 that is within the pattern; linear over ``soft`` cells."""
    # distance from the nearest printed edge within the pattern, over half the width of the soft edge
    nearest = min(max(math.floor(at + 0.5), 1.0), cells - 1.0)
    sign = 1.0 if int(nearest) % 2 == 0 else -1.0
    wave = sign * min(max((at - nearest) / (0.5 * soft), -1.0), 1.0)
    cover = min(max(min(at, cells - at) / soft + 0.5, 0.0), 1.0)
    return wave, cover


@kernel
def _fractal(seed: np.uint64, x: float, y: float, z: float) -> float:
    """Texture -1..1 with features of 0.5, 0.15 and 0.04 mm."""
    # three octaves of value noise; their mean is 0.5
    total = 0.5 * value_noise(seed, 2 * x, 2 * y, 2 * z)
    total += 0.3 * value_noise(seed, 6.7 * x, 6.7 * y, 6.7 * z)
    total += 0.2 * value_noise(seed, 25 * x, 25 * y, 25 * z)
    return min(max(2.2 * (2 * total - 1), -1.0), 1.0)


@kernel
def paint(
    form: ObjectForm,
    points: F8,
    on_object: Mask,
    object_material: int,
    seed: np.uint64,
    contrast: float,
    board: tuple[float, int, int],
    pixel_mm: float,
    albedo: F4,
) -> None:
    """Fill albedo [n, 3] (linear RGB) of points [n, 3]; board is (square_mm, columns, rows)."""
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        material = object_material if on_object[i] else FOIL
        if material == BOARD:
            white = _checks(form, x, y, z, board[0], board[1], board[2], pixel_mm)
            for c in range(3):
                albedo[i, c] = BLACK_ALBEDO + white * (WHITE_ALBEDO[c] - BLACK_ALBEDO)
            continue
        u, v, w = to_local(form, x, y, z) if on_object[i] else (x, y, z)
        texture = _fractal(seed, u, v, w)
        factor = 1.0 + contrast * texture
        stain = max(value_noise(seed ^ np.uint64(77), 1.3 * u, 1.3 * v, 1.3 * w) - 0.62, 0.0) * 4.0 * contrast
        for c in range(3):
            if material == BONE:
                albedo[i, c] = (BONE_ALBEDO[c] + min(stain, 1.0) * (BONE_STAIN[c] - BONE_ALBEDO[c])) * factor
            elif material == WHITE:
                albedo[i, c] = WHITE_ALBEDO[c] * (1.0 + 0.2 * contrast * texture)
            else:
                albedo[i, c] = FOIL_ALBEDO[c] * (1.0 + 2.0 * contrast * texture)


@kernel
def _lean(seed: np.uint64, scale: float, x: float, y: float, z: float) -> Vector:
    """Three smooth random values of about -1..1 that tilt a shading normal; two octaves."""
    # lattices turned against the world's axes and each other, so that no grid shows in the shading
    p, q, r = scale * (0.8 * x + 0.6 * y), scale * (0.8 * y - 0.6 * x), scale * z
    total = (0.0, 0.0, 0.0)
    for octave in range(2):
        a = value_noise(mix64(seed ^ np.uint64(3 * octave + 1)), p, q, r)
        b = value_noise(mix64(seed ^ np.uint64(3 * octave + 2)), p, q, r)
        c = value_noise(mix64(seed ^ np.uint64(3 * octave + 3)), p, q, r)
        total = (total[0] + a - 0.5, total[1] + b - 0.5, total[2] + c - 0.5)
        p, q, r = 2.3 * (0.6 * p - 0.8 * q), 2.3 * (0.8 * p + 0.6 * q), 2.3 * r
    return 1.4 * total[0], 1.4 * total[1], 1.4 * total[2]


@kernel
def shading_normal(
    seed: np.uint64, material: int, relief: float, x: float, y: float, z: float, normal: Vector
) -> Vector:
    """The normal tilted by the fine relief: pores of 30 to 70 um on bone, creases of 0.2 to 0.5 mm on foil."""
    scale, strength = 15.0, relief
    if material == FOIL:
        scale, strength = 2.0, 2.5 * relief
    if material in (WHITE, BOARD) or relief == 0.0:
        return normal[0], normal[1], normal[2]
    a, b, c = _lean(seed, scale, x, y, z)
    a, b, c = normal[0] + strength * a, normal[1] + strength * b, normal[2] + strength * c
    length = math.sqrt(a * a + b * b + c * c)
    return a / length, b / length, c / length


@kernel
def room_light(form: ObjectForm, x: float, y: float, z: float, normal: Vector) -> float:
    """Share 0..1 of the room's light from above that reaches a surface, by its tilt and by what stands beside it."""
    # ambient occlusion: the distance to the object a little way off the surface, relative to that way
    open_share = 1.0
    for reach in OCCLUSION_REACH_MM:
        distance = signed_distance(form, x + reach * normal[0], y + reach * normal[1], z + reach * normal[2])
        open_share = min(open_share, 0.3 + 0.7 * max(distance, 0.0) / reach)
    return open_share * (0.6 + 0.4 * normal[2])
