"""Cameras without a trigger input: they run freely, and the host picks the first frame that began after a shot.

No hardware counts frames, and `CameraInfo` says so. A frame is matched by time alone, so the stage must stand still
(step mode).
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from typing import Any, Protocol

from numpy.typing import NDArray

from acquire.contract.errors import SweepscopeError
from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.process.clocks import mono_ns
from acquire.contract.units import NS_PER_MS

from .protocol import CameraFrame, CameraGone, CameraInfo, CameraSettings, CameraSink
from .reader_thread import ReaderThread

logger = logging.getLogger(__name__)
_MOST_WAITING = 64
"""Shots that may wait for their frame; a sweep in step mode has one."""


class FrameSource(Protocol):
    """A source of consecutive pictures."""

    kind: str

    def open(self) -> FrameFormat:
        """Connect and start.

        Raises:
            SweepscopeError: it is not found, or its format cannot be stored.
        """
        ...

    def close(self) -> None:
        """Stop and disconnect; idempotent, never raises."""
        ...

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings; returns those in effect."""
        ...

    def limits(self) -> dict[str, tuple[float, float]]:
        """[lowest, highest] of each setting that has bounds."""
        ...

    def grab(self) -> NDArray[Any]:
        """The next picture ([h, w] or [h, w, 3] RGB, the caller's own), waiting for it.

        Raises:
            SweepscopeError: no picture arrives.
        """
        ...


class FreeRunningCamera:
    """Reads a source in a thread, so that no old picture waits in a buffer."""

    def __init__(self, source: FrameSource) -> None:
        self._source = source
        self._sink: CameraSink = lambda _event: None
        self._waiting: deque[int] = deque(maxlen=_MOST_WAITING)
        self._lock = threading.Lock()
        self._reading = ReaderThread(f"{source.kind}-camera", self._serve)
        self._armed = False
        self._frame_id = 0
        self._exposure_ns = 0
        self._settings: CameraSettings | None = None

    def open(self, sink: CameraSink) -> CameraInfo:
        """Connect the source and start reading."""
        self._sink = sink
        frame_format = self._source.open()
        limits = self._source.limits()
        self._reading.begin()
        return CameraInfo(kind=self._source.kind, format=frame_format, counts_frames=False, limits=limits)

    def close(self) -> None:
        """Stop reading, disconnect; idempotent."""
        self._armed = False
        self._reading.end()
        self._source.close()

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings; returns what the camera really uses."""
        used = self._source.configure(settings)
        self._exposure_ns = round(used.exposure_ms * NS_PER_MS)
        self._settings = used
        return used

    def arm(self) -> None:
        """Deliver one frame per shot from now on; earlier requests are dropped."""
        with self._lock:
            self._waiting.clear()
            self._armed = True

    def disarm(self) -> None:
        """Stop delivering."""
        with self._lock:
            self._waiting.clear()
            self._armed = False

    def snap(self) -> None:
        """Deliver one frame that begins from now on."""
        self._want(mono_ns())

    def fire(self, at_ns: int, position_steps: int) -> None:
        """The stage stands still since ``at_ns`` (CLOCK_MONOTONIC): deliver a frame that began after it."""
        if self._armed:
            self._want(at_ns)

    def _want(self, at_ns: int) -> None:
        with self._lock:
            self._waiting.append(at_ns)

    def _serve(self) -> None:
        began_after_ns = mono_ns()
        while not self._reading.ending:
            try:
                pixels = self._source.grab()
            except SweepscopeError as error:
                logger.error("the camera delivers nothing any more: %s", error)
                with self._lock:
                    # the sweep requests the dropped shots again
                    self._waiting.clear()
                self._sink(CameraGone(str(error)))
                if self._reading.until_back(self._open_again, (SweepscopeError,)):
                    began_after_ns = mono_ns()
                    self._sink(CameraGone("", back=True))
                continue
            self._deliver(pixels, began_after_ns)
            began_after_ns = mono_ns()

    def _open_again(self) -> None:
        self._source.close()
        self._source.open()
        if self._settings is not None:
            self._source.configure(self._settings)

    def _deliver(self, pixels: NDArray[Any], began_after_ns: int) -> None:
        """A picture may have begun to expose as early as one exposure before the previous picture arrived."""
        surely_from_ns = began_after_ns - self._exposure_ns
        with self._lock:
            if not self._waiting or self._waiting[0] > surely_from_ns:
                return
            at_ns = self._waiting.popleft()
            frame_id, self._frame_id = self._frame_id, self._frame_id + 1
        self._sink(CameraFrame(pixels, frame_id, max(at_ns, surely_from_ns)))
