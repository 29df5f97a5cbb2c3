"""Pictures of the simulated camera for a stage position: light, noise, quantisation. Pure and reproducible."""

# ruff: noqa: PLR0917 - kernels take their arrays and numbers by position

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .kernels import F4, kernel
from .noise import TABLE_BITS, counter_bits, frame_key, normal_table
from .optics import Projector, lit_fraction
from .raycast import visible_share
from .scene import SimulatedScene

COUNTS_AT_DEFAULT = 300.0
"""Counts of 8 bit of a white surface at normal incidence with the default camera settings (bone: 60 to 80 %)."""
_TABLE_MASK = np.uint64((1 << TABLE_BITS) - 1)
_TABLE_SHIFT = np.uint64(TABLE_BITS)
ALL_FREE, NONE_FREE = np.uint64(0xFFFFFFFFFFFFFFFF), np.uint64(0)


PixelLight = tuple[NDArray[Any], ...]
"""Flat arrays of a scene: points_mm, crossing_steps, width_steps, windows, shadow_bits(, irradiance, room)."""


@dataclass(frozen=True)
class CameraDefaults:
    """Camera settings that the scene's brightness is made for."""

    exposure_ms: float = 30.0
    gain: float = 6.0
    brightness: float = 0.0


DEFAULT_CAMERA = CameraDefaults()


class Renderer:
    """Renders frames of one scene; a frame does not depend on the frames before it."""

    def __init__(self, scene: SimulatedScene):
        self.scene = scene
        self._table = normal_table()
        height, width, channels = scene.albedo.shape
        count = height * width
        self._shape = (height, width, 3) if channels == 3 else (height, width)
        self._flat = (
            scene.points_mm.reshape(count, 3),
            scene.crossing_steps.reshape(count),
            scene.width_steps.reshape(count),
            scene.windows.reshape(count, 4),
            scene.shadow_bits.reshape(count),
            scene.irradiance.reshape(count),
            scene.room.reshape(count),
            scene.albedo.reshape(count, channels),
        )

    def render(
        self,
        position_steps: float,
        *,
        lamp: float = 1.0,
        exposure_ms: float,
        gain: float,
        brightness: float,
        attempt: int = 0,
        room: float = 1.0,
        travel_steps: float = 0.0,
    ) -> NDArray[Any]:
        """One frame, [h, w] mono or [h, w, 3] RGB; uint8, or uint16 right-aligned by bit_depth; owned by the caller.

        Args:
            position_steps: stage position at mid-exposure in microsteps.
            lamp: brightness of the lamp, 1 is steady state, 0 off.
            exposure_ms: exposure (shutter) in ms.
            gain: gain in dB.
            brightness: black level in percent of full scale.
            attempt: take of this frame; changes the noise only with ``retake_noise``.
            room: factor on the room's light.
            travel_steps: travel during the exposure, in microsteps (motion blur).
        """
        config = self.scene.config
        # all quantities in levels of the stored depth; the counts of 8 bit of the configuration are scaled
        factor = COUNTS_AT_DEFAULT * light_factor(exposure_ms, gain)
        offset = 2.55 * brightness
        levels = (2**config.bit_depth - 1) / 255
        read, shot = noise_model(config.read_noise_counts, config.full_well_electrons, gain)
        key = frame_key(config.seed, position_steps, attempt if config.retake_noise else 0)
        true_position = float(position_steps) + config.rehome_error_steps
        image = np.empty(self._shape, dtype=np.uint8 if config.bit_depth == 8 else np.uint16)
        *light, albedo = self._flat
        shadows = (self.scene.shadow_before_steps, self.scene.shadow_pitch_steps)
        exposure = (factor * levels, float(lamp), float(room), offset * levels)
        noise = (read * levels, shot * levels)
        flat = image.reshape(albedo.shape)
        peak = 2**config.bit_depth - 1
        _render(
            self.scene.projector, tuple(light), albedo, shadows, true_position, abs(float(travel_steps)),
            exposure, noise, key, self._table, peak, flat,
        )  # fmt: skip
        return image


def light_factor(exposure_ms: float, gain: float) -> float:
    """Brightness relative to the default camera settings: linear in exposure, gain in dB."""
    return exposure_ms / DEFAULT_CAMERA.exposure_ms * 10 ** ((gain - DEFAULT_CAMERA.gain) / 20)


def noise_model(read_noise_counts: float, full_well_electrons: float, gain: float) -> tuple[float, float]:
    """Standard deviation in the dark (counts of 8 bit) and variance per count of signal, at a gain in dB."""
    read = read_noise_counts * 10 ** ((gain - DEFAULT_CAMERA.gain) / 20)
    shot = 255 / full_well_electrons * 10 ** (gain / 20) if full_well_electrons > 0 else 0.0
    return read, shot


@kernel
def lamp_share(
    projector: Projector,
    light: PixelLight,
    shadows: tuple[float, float],
    i: int,
    position_steps: float,
    travel_steps: float,
) -> float:
    """Share 0..1 of the lamp on pixel i near an edge: the slide's three edges times the shadows."""
    points, crossing, width, _, bits = light[:5]
    # motion blur: a uniform travel has the variance travel^2 / 12
    blur = math.sqrt(width[i] ** 2 + travel_steps**2 / 12)
    share = lit_fraction(projector, points[i, 0], points[i, 1], points[i, 2], position_steps, blur)
    if bits[i] != ALL_FREE:
        share *= visible_share(bits[i], position_steps - crossing[i], shadows[0], shadows[1])
    return share


@kernel
def _render(
    projector: Projector,
    light: PixelLight,
    albedo: F4,
    shadows: tuple[float, float],
    position_steps: float,
    travel_steps: float,
    exposure: tuple[float, float, float, float],
    noise: tuple[float, float],
    key: np.uint64,
    table: F4,
    peak: int,
    image: NDArray[Any],
) -> None:
    """Light, noise and quantisation, pixel by pixel; image is [n, channels].

    Most pixels are dark or fully lit; only those near an edge or in a shadow need the exact, slower share of the lamp.
    """
    _, _, _, windows, bits, irradiance, room = light
    factor, lamp, room_factor, offset = exposure
    read_variance, shot, half = np.float32(noise[0] * noise[0]), np.float32(noise[1]), np.float32(offset + 0.5)
    begin, end = np.float32(position_steps - 1.5 * travel_steps), np.float32(position_steps + 1.5 * travel_steps)
    top = np.float32(peak)
    for i in range(image.shape[0]):
        # windows and bits were found once for the scene: most pixels need no arithmetic of light at all
        light_here = room_factor * room[i]
        if end > windows[i, 0] and begin < windows[i, 3] and bits[i] != NONE_FREE:
            share = 1.0
            if begin < windows[i, 1] or end > windows[i, 2] or bits[i] != ALL_FREE:
                share = lamp_share(projector, light, shadows, i, position_steps, travel_steps)
            light_here += lamp * share * irradiance[i]
        total = np.float32(factor * light_here)
        # 64 random bits give each channel its own 14, an index into the table of normal quantiles
        word = counter_bits(key, i)
        for c in range(image.shape[1]):
            signal = total * albedo[i, c]
            # shot noise has the variance shot x signal; half a level is added for rounding by truncation
            noisy = signal + half + np.sqrt(read_variance + shot * signal) * table[word & _TABLE_MASK]
            word >>= _TABLE_SHIFT
            image[i, c] = np.int32(min(max(noisy, np.float32(0)), top))
