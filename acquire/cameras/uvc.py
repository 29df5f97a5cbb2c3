"""A webcam as a source of pictures (Video4Linux through OpenCV): no trigger input, settings in the driver's units."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from acquire.contract.config.model import CameraConfig
from acquire.contract.errors import ConfigError, SweepscopeError
from acquire.contract.messaging.messages import FrameFormat

from .protocol import CameraSettings

_V4L_MANUAL_EXPOSURE = 1
_V4L_EXPOSURES_PER_MS = 10
"""``exposure_time_absolute`` counts 100 us."""

Opener = Callable[[str], cv2.VideoCapture]


def open_capture(device: str) -> cv2.VideoCapture:
    """OpenCV's capture of ``/dev/videoN`` (the first one where ``device`` is empty)."""
    return cv2.VideoCapture(device or "/dev/video0", cv2.CAP_V4L2)


class UvcSource:
    """Frames of one webcam, in RGB. Gain and brightness are in the units of its driver."""

    kind = "uvc"

    def __init__(self, config: CameraConfig, opener: Opener = open_capture) -> None:
        self._config, self._opener = config, opener
        self._capture: cv2.VideoCapture | None = None
        self._format = FrameFormat(config.width, config.height, 8, "rgb")

    def open(self) -> FrameFormat:
        """Open the device at the configured size.

        Raises:
            ConfigError: no such device, or it delivers another size.
        """
        name = self._config.device or "/dev/video0"
        capture = self._opener(self._config.device)
        if not capture.isOpened():
            raise ConfigError(f"no camera answers at {name}: plug it in, or set camera.device (sweepscope doctor)")
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, self._config.width)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self._config.height)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        self._capture = capture
        found = self.grab().shape
        if found != self._format.shape:
            self.close()
            raise ConfigError(
                f"the camera at {name} delivers {found[1]} x {found[0]}, not {self._config.width} x "
                f"{self._config.height}: set camera.width and camera.height to what it has"
            )
        return self._format

    def close(self) -> None:
        """Release the device; idempotent."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Exposure by hand, and the driver's own gain and brightness; returns the values read back."""
        if self._capture is None:
            return settings
        wanted = {
            cv2.CAP_PROP_AUTO_EXPOSURE: _V4L_MANUAL_EXPOSURE,
            cv2.CAP_PROP_EXPOSURE: settings.exposure_ms * _V4L_EXPOSURES_PER_MS,
            cv2.CAP_PROP_GAIN: settings.gain,
            cv2.CAP_PROP_BRIGHTNESS: settings.brightness_percent,
        }
        for key, value in wanted.items():
            self._capture.set(key, value)
        exposure = self._capture.get(cv2.CAP_PROP_EXPOSURE)
        return CameraSettings(
            exposure / _V4L_EXPOSURES_PER_MS if exposure > 0 else settings.exposure_ms,
            settings.gain,
            settings.brightness_percent,
        )

    def limits(self) -> dict[str, tuple[float, float]]:
        """None: OpenCV does not report the limits of a webcam."""
        return {}

    def grab(self) -> NDArray[Any]:
        """The next picture, RGB.

        Raises:
            SweepscopeError: the device was removed.
        """
        found, picture = self._capture.read() if self._capture is not None else (False, None)
        if not found or picture is None:
            raise SweepscopeError(f"the camera at {self._config.device or '/dev/video0'} is gone: plug it in again")
        return np.ascontiguousarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
