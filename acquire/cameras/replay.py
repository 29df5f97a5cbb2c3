"""Camera that replays a folder of pictures or a scan: frame k at the position of frame k of the sweep."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.config.load import home_resolved
from acquire.contract.config.model import RigConfig
from acquire.contract.errors import ConfigError, ScanFileError
from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.process.clocks import mono_ns
from acquire.contract.scan_data.reader import ScanReader
from acquire.pictures.sequence import UnprovenError, prove_sequence

from .protocol import CameraFrame, CameraInfo, CameraSettings, CameraSink

_JOIN_S = 10.0
ReadFrame = Callable[[int], NDArray[Any]]


class ReplayCamera:
    """Answers each shot with the recorded frame of that position, or with the nearest one outside the recording."""

    def __init__(self, config: RigConfig) -> None:
        self._config = config
        self._sink: CameraSink = lambda _event: None
        self._shots: queue.SimpleQueue[tuple[int, int] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._scan: ScanReader | None = None
        self._armed = False
        self._frame_id = self._position_steps = 0

    def open(self, sink: CameraSink) -> CameraInfo:
        """Open the recording.

        Raises:
            ConfigError: camera.device names none.
            ScanFileError: it cannot be read, or its pictures are not proven to be a sequence.
        """
        if not self._config.camera.device:
            raise ConfigError("camera.kind = 'replay' needs camera.device: the folder of pictures or the scan to show")
        self._sink = sink
        self._count, frame_format, self._read = self._recording(
            home_resolved(self._config.camera.device, "camera.device")
        )
        self._thread = threading.Thread(target=self._serve, name="replay-camera", daemon=True)
        self._thread.start()
        return CameraInfo(kind="replay", format=frame_format, counts_frames=False)

    def _recording(self, path: Path) -> tuple[int, FrameFormat, ReadFrame]:
        if path.is_dir() and not any(path.glob("scan*.h5")):
            try:
                found = prove_sequence(path)
            except UnprovenError as error:
                raise ScanFileError(
                    f"{error.fact}; import it ('sweepscope import --help' has the options), and name the scan in "
                    "camera.device"
                ) from None
            return len(found.frames), found.format, found.read
        self._scan = scan = ScanReader(path)
        return scan.count, scan.layout.format, scan.frame

    def close(self) -> None:
        """End; idempotent."""
        self._armed = False
        if self._thread is not None:
            self._shots.put(None)
            self._thread.join(timeout=_JOIN_S)
            self._thread = None
        if self._scan is not None:
            self._scan.close()
            self._scan = None

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Stores the settings; they cannot change recorded pictures."""
        return settings

    def arm(self) -> None:
        """Deliver frames from now on."""
        self._armed = True

    def disarm(self) -> None:
        """Stop delivering frames."""
        self._armed = False

    def snap(self) -> None:
        """The frame of the last shot's position."""
        self._shots.put((self._position_steps, mono_ns()))

    def fire(self, at_ns: int, position_steps: int) -> None:
        """A shot at ``position_steps``."""
        self._position_steps = position_steps
        if self._armed:
            self._shots.put((position_steps, at_ns))

    def _serve(self) -> None:
        while (shot := self._shots.get()) is not None:
            position_steps, at_ns = shot
            sweep = self._config.sweep
            direction = 1 if sweep.last_steps >= sweep.first_steps else -1
            place = direction * (position_steps - sweep.first_steps) // sweep.steps_per_frame
            pixels = np.ascontiguousarray(self._read(min(max(place, 0), self._count - 1)))
            frame_id, self._frame_id = self._frame_id, self._frame_id + 1
            self._sink(CameraFrame(pixels, frame_id, at_ns))
