"""Takes pictures of the present scene at several exposures, to measure the camera's response to light."""

from __future__ import annotations

import queue
import time
from collections.abc import Sequence
from typing import Any

import msgspec
from numpy.typing import NDArray

from acquire.cameras.protocol import Camera, CameraFrame, CameraSettings
from acquire.contract.config.model import RigConfig
from acquire.contract.errors import SweepscopeError

SETTLE_FRAMES = 2
"""Pictures that are discarded after a change of the exposure: some cameras apply it late."""


class Exposure(msgspec.Struct, frozen=True):
    """One picture."""

    exposure_ms: float
    """As the camera really applied it."""
    pixels: Any
    """[h, w] or [h, w, 3] as delivered."""


def take_exposures(camera: Camera, config: RigConfig, exposures_ms: Sequence[float]) -> list[Exposure]:
    """One picture per exposure, by software trigger; opens and closes the camera.

    Args:
        camera: not open; no other program may hold it.
        config: gain, brightness and time-out are taken from ``[camera]``.
        exposures_ms: wanted; the camera may round or limit them.

    Raises:
        SweepscopeError: no picture came in time.
    """
    frames: queue.Queue[CameraFrame] = queue.Queue()
    camera.open(lambda found: frames.put(found) if isinstance(found, CameraFrame) else None)
    try:
        taken = []
        for wished in exposures_ms:
            settings = CameraSettings(wished, config.camera.gain, config.camera.brightness_percent)
            used = camera.configure(settings).exposure_ms
            for _ in range(SETTLE_FRAMES + 1):
                pixels = _snapped(camera, frames, (config.camera.frame_timeout_ms + used) / 1000)
            taken.append(Exposure(used, pixels))
        return taken
    finally:
        camera.close()


def _snapped(camera: Camera, frames: queue.Queue[CameraFrame], timeout_s: float) -> NDArray[Any]:
    while not frames.empty():
        frames.get_nowait()
    began_s = time.monotonic()
    camera.snap()
    try:
        return frames.get(timeout=timeout_s).pixels
    except queue.Empty:
        waited_s = time.monotonic() - began_s
        raise SweepscopeError(
            f"no picture came within {waited_s:.1f} s: is the camera free (stop the daemon first) and connected?"
        ) from None
