"""Ground truth of a simulated sweep: what an estimator without noise or error would find."""

# ruff: noqa: PLR0917 - kernels take their arrays and numbers by position

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ConfigError
from acquire.contract.files import replace_file
from acquire.contract.scan_data.default_plot import add_default_plot

from .kernels import F4, F8, Mask, kernel
from .optics import Projector, normal_cdf
from .render import COUNTS_AT_DEFAULT, NONE_FREE, PixelLight, lamp_share
from .scene import SimulatedScene

PLATEAU_SIGMAS = 3.5
"""Blurs before and after the crossing that have to be in the frames for a pixel to count as visible."""
PLATEAU_SHARE = 0.999
_LONG_NAMES = {
    "crossing": "true crossing (frames)",
    "visible": "lit by the sweep and seen (0 or 1)",
    "amplitude": "brightness range (counts of 8 bit)",
    "edge_width": "standard deviation of the light edge (frames)",
}
GREY = np.array([0.299, 0.587, 0.114])


@dataclass(frozen=True, eq=False)
class Truth:
    """Arrays of truth.h5, each [h, w]; frames are counted from 0."""

    points: F8
    """[h, w, 3] mm."""
    crossing: F8
    """Fractional frame index at which the light plane passes the point; NaN outside of the sweep."""
    normals: F4
    """[h, w, 3] outward."""
    visible: NDArray[np.uint8]
    """1: lit by the sweep from dark to plateau, with no shadow in between, and seen by the camera."""
    amplitude: F4
    """Greatest minus least brightness (OpenCV's grey) without noise, default camera settings, counts of 8 bit."""
    edge_width: F4
    """Standard deviation of the light edge in frames."""


def truth(scene: SimulatedScene, first_steps: int, steps_per_frame: int, count: int) -> Truth:
    """The truth of the sweep with frame k at first_steps + k steps_per_frame (negative: the other way), k < count.

    Raises:
        ConfigError: no frames, or a sweep that does not move.
    """
    if count < 1 or steps_per_frame == 0:
        raise ConfigError(f"no truth of {count} frames {steps_per_frame} microsteps apart: it takes a sweep")
    height, width = scene.irradiance.shape
    crossing = (scene.crossing_steps - scene.config.rehome_error_steps - first_steps) / steps_per_frame
    edge_width = scene.width_steps / abs(steps_per_frame)
    positions = scene.config.rehome_error_steps + first_steps + steps_per_frame * np.arange(count, dtype=float)
    flat = tuple(array.reshape(height * width, *array.shape[2:]) for array in _light_arrays(scene))
    low, high = np.empty(height * width), np.empty(height * width)
    clean = np.empty(height * width, dtype=np.bool_)
    shadows = (scene.shadow_before_steps, scene.shadow_pitch_steps)
    _extremes(scene.projector, flat, shadows, np.sort(positions), low, high, clean)
    # OpenCV's grey, as the fold makes it
    grey = scene.albedo @ GREY.astype(np.float32) if scene.albedo.shape[2] == 3 else scene.albedo[..., 0]
    full, dark = (_counts(scene, grey, share.reshape(height, width)) for share in (high, low))
    margin = PLATEAU_SIGMAS * edge_width
    inside = (crossing >= margin) & (crossing <= count - 1 - margin)
    crossing = np.where((crossing >= 0) & (crossing <= count - 1), crossing, np.nan)
    return Truth(
        points=scene.points_mm,
        crossing=crossing,
        normals=scene.normals.astype(np.float32),
        visible=(clean.reshape(height, width) & inside & (scene.irradiance > 0)).astype(np.uint8),
        amplitude=(full - dark).astype(np.float32),
        edge_width=edge_width.astype(np.float32),
    )


def write_truth(path: Path, truth: Truth) -> None:
    """Write truth.h5."""

    def write(temporary: Path) -> None:
        with h5py.File(temporary, "w") as file:
            for name in ("points", "crossing", "normals", "visible", "amplitude", "edge_width"):
                file[name] = getattr(truth, name)
            add_default_plot(file, "crossing", _LONG_NAMES)

    replace_file(Path(path), write)


def _light_arrays(scene: SimulatedScene) -> tuple[NDArray[np.generic], ...]:
    """The arrays that render.lamp_share reads, in its order."""
    return (scene.points_mm, scene.crossing_steps, scene.width_steps, scene.windows, scene.shadow_bits)


def _counts(scene: SimulatedScene, grey: F4, share: F8) -> F8:
    """Brightness in counts of 8 bit, saturated, when ``share`` of the lamp falls on each pixel."""
    return np.minimum(255.0, COUNTS_AT_DEFAULT * grey * (share * scene.irradiance + scene.room))


@kernel
def _extremes(
    projector: Projector, light: PixelLight, shadows: tuple[float, float], positions: F8, low: F8, high: F8, clean: Mask
) -> None:
    """Least and greatest share of the lamp over all positions (ascending), and whether the leading edge is clean.

    Clean: no shadow from PLATEAU_SIGMAS before the crossing until as far after it, and the plateau is reached.
    """
    _, crossing, width, windows, bits = light
    for i in range(crossing.shape[0]):
        low[i], high[i], clean[i] = 0.0, 0.0, False
        if bits[i] == NONE_FREE or windows[i, 0] > windows[i, 3]:
            continue
        # outside of its window a pixel is dark, so the extremes lie among the frames within it
        starts_dark = positions[0] <= windows[i, 0] or positions[-1] >= windows[i, 3]
        low[i] = 0.0 if starts_dark else 1.0
        for k in range(np.searchsorted(positions, windows[i, 0]), np.searchsorted(positions, windows[i, 3])):
            share = lamp_share(projector, light, shadows, i, positions[k], 0.0)
            low[i], high[i] = min(low[i], share), max(high[i], share)
            # dark before and on the plateau: further frames change neither extreme
            if starts_dark and high[i] > PLATEAU_SHARE:
                break
        clean[i] = high[i] > PLATEAU_SHARE and _is_clean(projector, light, shadows, i)


@kernel
def _is_clean(projector: Projector, light: PixelLight, shadows: tuple[float, float], i: int) -> bool:
    """Whether the light about the crossing is what the leading edge alone lets through."""
    crossing, width = light[1][i], light[2][i]
    # in quarters of the blur: a shadow's edge is not much sharper than the light's
    for quarter in range(-int(4 * PLATEAU_SIGMAS), int(4 * PLATEAU_SIGMAS) + 1):
        alone = normal_cdf(0.25 * quarter)
        position = crossing + 0.25 * quarter * width
        if lamp_share(projector, light, shadows, i, position, 0.0) < PLATEAU_SHARE * alone:
            return False
    return True
