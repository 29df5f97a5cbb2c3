"""The simulated scene: everything of each pixel that does not change while the stage moves.

Lengths in mm, stage positions in microsteps; arrays [h, w].
"""

# ruff: noqa: PLR0917 - kernels take their arrays and numbers by position

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np

from acquire.contract.config.simulation import SimulationConfig
from acquire.contract.errors import ConfigError

from . import materials, raycast
from .kernels import F4, F8, Bits, Mask, kernel
from .materials import room_light, shading_normal
from .objects import ObjectForm, place_object
from .optics import EDGE_SIGMAS, PinholeCamera, Projector, dot, lit_interval, paper_camera, paper_projector

MATERIALS = {
    "stirrup": materials.BONE,
    "dome": materials.BONE,
    "wedge": materials.WHITE,
    "flat": materials.WHITE,
    "checkerboard": materials.BOARD,
}
MIN_FACING = 0.01
"""Least cosine between normal and light; a surface that the light only grazes is dark."""


@dataclass(frozen=True, eq=False)
class SimulatedScene:
    """Geometry, light and albedo of every pixel; positions are the projector's true ones."""

    config: SimulationConfig
    um_per_microstep: float
    camera: PinholeCamera
    projector: Projector
    form: ObjectForm
    points_mm: F8
    """[h, w, 3] the surface that the pixel sees."""
    normals: F8
    """[h, w, 3] unit normals of the form (without the fine relief)."""
    on_object: Mask
    """[h, w] True for the object, False for the foil of the stage."""
    crossing_steps: F8
    """[h, w] stage position at which the light plane passes the point."""
    width_steps: F8
    """[h, w] standard deviation of the light edge there, in microsteps of travel."""
    albedo: F4
    """[h, w, 3] linear RGB, or [h, w, 1] grey."""
    irradiance: F4
    """[h, w] light of the lamp at the pixel's own crossing; 1 at normal incidence in the corner."""
    room: F4
    """[h, w] light of the room, in the same unit."""
    shadow_bits: Bits
    """[h, w] shadows by stage position (raycast.visibility_bits)."""
    shadow_before_steps: float
    """First position of shadow_bits, ahead of the crossing."""
    shadow_pitch_steps: float
    """Microsteps between two of its positions."""
    windows: F4
    """[h, w, 4] positions: not dark from, fully lit from, fully lit until, dark after; without shadows."""

    @property
    def stage_z_mm(self) -> float:
        """Height of the foil."""
        return -self.config.board_thickness_mm


def build_scene(config: SimulationConfig, *, width: int, height: int, um_per_microstep: float) -> SimulatedScene:
    """Build the scene by casting every ray once; takes a second or two at 1024 x 768.

    The irradiance of a point is that at its own crossing and constant afterwards: the paper's half brightness
    (min + max) / 2 is defined for a lamp whose light does not change while the slide passes. A real projector comes
    up to 4 mm nearer while a point is lit, which would move the half point by up to one frame.

    Raises:
        ConfigError: a value out of its bounds, or an impossible size.
    """
    _check(config, width, height, um_per_microstep)
    camera, projector = paper_camera(config, width, height), paper_projector(config, um_per_microstep)
    form = place_object(config)
    count = width * height
    points, normals, on_object = np.empty((count, 3)), np.empty((count, 3)), np.empty(count, dtype=np.bool_)
    raycast.see_surfaces(
        form, -config.board_thickness_mm, camera.centre_mm, camera.rays().reshape(-1, 3), points, normals, on_object
    )
    crossing, edge_width = _crossings(projector, points)
    looks = _looks(config, form, points, on_object, config.camera_distance_mm / camera.matrix[0, 0])
    irradiance, room, facing = _light(config, form, projector, points, normals, on_object, crossing)
    # sampled with the widest blur of the picture, so that one pitch serves all pixels
    before, pitch = _shadow_sampling(projector, float(edge_width.max()))
    bits, windows = np.empty(count, dtype=np.uint64), np.empty((count, 4), dtype=np.float32)
    raycast.find_shadows(form, projector, points, crossing, edge_width, facing, before, pitch, EDGE_SIGMAS, bits)
    _find_windows(projector, points, crossing, edge_width, windows)
    shape = (height, width)
    return SimulatedScene(
        config=config,
        um_per_microstep=um_per_microstep,
        camera=camera,
        projector=projector,
        form=form,
        points_mm=points.reshape(*shape, 3),
        normals=normals.reshape(*shape, 3),
        on_object=on_object.reshape(shape),
        crossing_steps=crossing.reshape(shape),
        width_steps=edge_width.reshape(shape),
        albedo=looks.reshape(*shape, -1),
        irradiance=irradiance.reshape(shape),
        room=room.reshape(shape),
        shadow_bits=bits.reshape(shape),
        shadow_before_steps=before,
        shadow_pitch_steps=pitch,
        windows=windows.reshape(*shape, 4),
    )


def _check(config: SimulationConfig, width: int, height: int, um_per_microstep: float) -> None:
    try:
        msgspec.convert(msgspec.to_builtins(config), SimulationConfig)
    except msgspec.ValidationError as error:
        raise ConfigError(f"simulation: {error}; nothing was started, correct rig.toml") from None
    if not (1 <= width <= 16_384 and 1 <= height <= 16_384):
        raise ConfigError(f"simulation: a picture of {width} x {height} pixels is not possible (1 to 16384 each)")
    if not (math.isfinite(um_per_microstep) and um_per_microstep > 0):
        raise ConfigError(f"simulation: um_per_microstep must be a positive number; it is {um_per_microstep}")


def _crossings(projector: Projector, points: F8) -> tuple[F8, F8]:
    """Position at which the plane passes each point, and the blur there, both [n] in microsteps."""
    normal = np.array(projector.normal)
    crossing = (points - np.array(projector.corner_mm)) @ normal / projector.normal_step_mm
    # the blur grows with the distance from the focus along the optical axis
    from_apex = points - np.array(projector.apex_mm) - crossing[:, None] * np.array(projector.step_mm)
    defocus_mm = from_apex @ np.array(projector.axis) - projector.focus_mm
    return crossing, np.hypot(projector.best_width_steps, projector.defocus_steps_per_mm * defocus_mm)


def _looks(config: SimulationConfig, form: ObjectForm, points: F8, on_object: Mask, pixel_mm: float) -> F4:
    """Albedo [n, 3], or [n, 1] by OpenCV's grey weights for a mono camera."""
    albedo = np.empty((len(points), 3), dtype=np.float32)
    board = (config.board_square_mm, config.board_columns, config.board_rows)
    material, contrast = MATERIALS[config.object], config.albedo_contrast
    materials.paint(form, points, on_object, material, np.uint64(config.seed), contrast, board, pixel_mm, albedo)
    if config.colour:
        return albedo
    return albedo @ np.array([[0.299], [0.587], [0.114]], dtype=np.float32)


def _light(
    config: SimulationConfig,
    form: ObjectForm,
    projector: Projector,
    points: F8,
    normals: F8,
    on_object: Mask,
    crossing: F8,
) -> tuple[F4, F4, F4]:
    """Light of lamp and room, and the cosine between normal and light less MIN_FACING, each [n]."""
    irradiance, room, facing = (np.empty(len(points), dtype=np.float32) for _ in range(3))
    ambient = config.board_ambient if config.object == "checkerboard" else config.ambient
    material, seed = MATERIALS[config.object], np.uint64(config.seed)
    _shade(
        form, projector, points, normals, on_object, crossing, material, seed, config.relief, irradiance, room, facing
    )
    room *= ambient
    return irradiance, room, facing


@kernel
def _shade(
    form: ObjectForm,
    projector: Projector,
    points: F8,
    normals: F8,
    on_object: Mask,
    crossing: F8,
    material: int,
    seed: np.uint64,
    relief: float,
    irradiance: F4,
    room: F4,
    facing: F4,
) -> None:
    """Lambert's law and the inverse square of the distance, at each pixel's own crossing."""
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        normal = (normals[i, 0], normals[i, 1], normals[i, 2])
        apex = raycast.apex_at(projector, crossing[i])
        a, b, c = apex[0] - x, apex[1] - y, apex[2] - z
        length = math.sqrt(a * a + b * b + c * c)
        light = (a / length, b / length, c / length)
        # the true normal decides whether the light reaches the surface, the relief only how bright it is
        facing[i] = dot(normal, light) - MIN_FACING
        rough = shading_normal(seed, material if on_object[i] else materials.FOIL, relief, x, y, z, normal)
        share = max(dot(rough, light), 0.0) if facing[i] > 0 else 0.0
        irradiance[i] = share * (projector.focus_mm / length) ** 2
        room[i] = room_light(form, x, y, z, normal)


def _shadow_sampling(projector: Projector, widest_steps: float) -> tuple[float, float]:
    """Microsteps ahead of the crossing, and between samples, that cover the longest time in the light."""
    before = EDGE_SIGMAS * widest_steps
    # the longest way within the cone of light, with a quarter to spare for points off the focus
    deepest_mm = (projector.radius_ratio * projector.focus_mm) / projector.normal_step_mm
    longest_steps = 1.25 * deepest_mm
    return before, (longest_steps + 2 * before) / (raycast.VISIBILITY_SAMPLES - 1)


@kernel
def _find_windows(projector: Projector, points: F8, crossing: F8, width: F8, windows: F4) -> None:
    """Fill windows [n, 4] (SimulatedScene.windows); a pixel that is never fully lit has an empty inner window."""
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        outer = lit_interval(projector, x, y, z, crossing[i], width[i], -EDGE_SIGMAS)
        inner = lit_interval(projector, x, y, z, crossing[i], width[i], EDGE_SIGMAS)
        windows[i] = (outer[0], inner[0], inner[1], outer[1])
