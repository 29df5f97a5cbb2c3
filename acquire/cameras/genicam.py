"""A GenICam camera (GigE Vision, USB3 Vision) through its maker's GenTL producer: hardware trigger, frame ids.

Feature names are those of the Standard Features Naming Convention (SFNC); a camera that lacks one keeps its own value,
and one without a trigger input can only run freely (``camera.trigger = "host"``).
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
from genicam.genapi import GenericException as GenApiError
from genicam.gentl import GenericException as GenTLError
from harvesters.core import Harvester
from numpy.typing import NDArray

from acquire.contract.config.load import home_resolved
from acquire.contract.config.model import CameraConfig
from acquire.contract.errors import ConfigError, SweepscopeError
from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.process.clocks import mono_ns
from acquire.contract.units import NS_PER_S

from .clock_check import CameraClock
from .protocol import CameraFrame, CameraGone, CameraInfo, CameraLostError, CameraSettings, CameraSink
from .reader_thread import ReaderThread

logger = logging.getLogger(__name__)

FORMATS: Final[dict[str, tuple[int, str]]] = {
    "Mono8": (8, "mono"),
    "Mono10": (10, "mono"),
    "Mono12": (12, "mono"),
    "Mono16": (16, "mono"),
    "RGB8": (8, "rgb"),
    "RGBa8": (8, "rgb"),
    "BayerRG8": (8, "bayer_rggb"),
    "BayerBG8": (8, "bayer_bggr"),
    "BayerGR8": (8, "bayer_grbg"),
    "BayerGB8": (8, "bayer_gbrg"),
    "BayerRG12": (12, "bayer_rggb"),
}
"""Pixel formats (PFNC names) that scans can store, with bit depth and our name."""

_ERRORS: Final = (GenApiError, GenTLError, RuntimeError, OSError, ValueError)
"""What the camera makers' libraries raise."""
_SIGNS: Final = ("TimestampLatch", "GevTimestampControlLatch")
"""Commands that change nothing and reach the camera; the first that it has is its sign of life."""
_QUIET_S = 1.0
"""A camera that sends nothing for so long is asked for a sign of life: not every producer tells of a pulled cable."""
_BUFFERS = 16
"""Pictures that may wait while the host is late."""
_BUSY_S = 0.5
_PATH = "GENICAM_GENTL64_PATH"
_FETCH_S = 0.1
_GRAB_S = 5.0
_US_PER_MS = 1000.0


class GenicamDevice:
    """One camera behind a GenTL producer: features and buffers. Also the picture source of a freely running camera."""

    kind = "genicam"

    def __init__(self, config: CameraConfig) -> None:
        self._config = config
        self._harvester: Harvester | None = None
        self._acquirer: Any = None
        self._own_id = 0
        self._clock = CameraClock()
        self._lock = threading.RLock()
        """Held while the camera is opened or closed, and while a feature is used."""
        self.format = FrameFormat(config.width, config.height, 8)
        self.counts_frames = True

    # ---- connect and close ----

    def open(self, trigger: str = "") -> FrameFormat:
        """Connect, set size and trigger input, start the stream.

        Args:
            trigger: the input line; empty: run freely.

        Raises:
            ConfigError: no producer, no such camera, no trigger input, or a format that scans cannot store.
            CameraLostError: the camera or its producer does not answer.
        """
        producers = _producers(self._config.producer)
        with self._lock, _as_camera_lost():
            self._clock = CameraClock()
            self._harvester = harvester = Harvester()
            try:
                for producer in producers:
                    harvester.add_file(str(producer))
                harvester.update()
                self._acquirer = harvester.create(self._chosen(harvester))
                self._set_up(trigger)
                self._acquirer.num_buffers = max(_BUFFERS, self._acquirer.min_num_buffers)
                self._acquirer.start()
            except BaseException:
                self.close()
                raise
        return self.format

    def _chosen(self, harvester: Harvester) -> int:
        found = [str(info.serial_number) for info in harvester.device_info_list]
        wanted = self._config.device
        if not wanted and len(found) == 1:
            return 0
        if wanted in found:
            return found.index(wanted)
        seen = f"there are {', '.join(found)}" if found else "there is none"
        raise ConfigError(
            f"no camera with serial number {wanted}: {seen}; set camera.device"
            if wanted
            else f"camera.device must name one camera by its serial number: {seen}"
        )

    def _set_up(self, trigger: str) -> None:
        self._set("Width", self._config.width)
        self._set("Height", self._config.height)
        self._set("AcquisitionMode", "Continuous")
        if trigger:
            self._set("TriggerSelector", "FrameStart")
            self._set("TriggerActivation", "RisingEdge")
            self._set("ExposureMode", "Timed")
            if not (self._set("TriggerSource", trigger) and self._set("TriggerMode", "On")):
                raise ConfigError(
                    f"the camera has no trigger input {trigger}: set camera.trigger to one that it has, "
                    "or to 'host' for a camera that runs freely"
                )
        else:
            self._set("TriggerMode", "Off")
        self.format = self._format()

    def _format(self) -> FrameFormat:
        name = str(self._get("PixelFormat"))
        if name not in FORMATS:
            raise ConfigError(f"the camera delivers {name}; scans can store {', '.join(FORMATS)}: set another there")
        width, height = int(self._get("Width")), int(self._get("Height"))
        if (width, height) != (self._config.width, self._config.height):
            raise ConfigError(
                f"the camera delivers {width} x {height}, not {self._config.width} x {self._config.height}: "
                "set camera.width and camera.height to what it has"
            )
        bit_depth, pixel_format = FORMATS[name]
        return FrameFormat(width, height, bit_depth, pixel_format)  # type: ignore[arg-type]

    def close(self) -> None:
        """Stop the stream and release the camera; idempotent, never raises."""
        with self._lock:
            acquirer, self._acquirer = self._acquirer, None
            harvester, self._harvester = self._harvester, None
            for step in (acquirer and acquirer.stop, acquirer and acquirer.destroy, harvester and harvester.reset):
                if step:
                    try:
                        step()
                    except _ERRORS as error:
                        logger.warning("a step of closing the camera failed: %s", error)

    # ---- features ----

    @contextmanager
    def _answering(self) -> Iterator[None]:
        """Turns errors of the libraries into :class:`CameraLostError`; refuses at once while the camera is away."""
        if not self._lock.acquire(timeout=_BUSY_S):
            raise CameraLostError("the camera is away and being looked for")
        try:
            if self._acquirer is None:
                raise CameraLostError("the camera is away")
            with _as_camera_lost():
                yield
        finally:
            self._lock.release()

    def _node(self, name: str) -> Any:
        nodes = self._acquirer.remote_device.node_map
        return getattr(nodes, name) if nodes.has_node(name) else None

    def _get(self, name: str) -> Any:
        node = self._node(name)
        return None if node is None else node.value

    def _set(self, name: str, value: Any) -> bool:
        """Set a feature; False if the camera lacks it or refuses the value."""
        node = self._node(name)
        if node is None:
            return False
        with suppress(*_ERRORS):
            node.value = value
        try:
            return bool(node.value == value) or isinstance(value, float)
        except _ERRORS:
            return False

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """ExposureTime (us), Gain (dB) and BlackLevel, within the camera's limits; returns the values read back.

        Raises:
            CameraLostError: it does not answer.
        """
        with self._answering():
            return self._configure(settings)

    def _configure(self, settings: CameraSettings) -> CameraSettings:
        limits = self._limits()
        wanted = {name: getattr(settings, name) for name in CameraSettings.__struct_fields__}
        clipped = {
            name: min(max(value, limits[name][0]), limits[name][1]) if name in limits else value
            for name, value in wanted.items()
        }
        self._set("ExposureAuto", "Off")
        self._set("GainAuto", "Off")
        self._set("ExposureTime", clipped["exposure_ms"] * _US_PER_MS)
        self._set("Gain", float(clipped["gain"]))
        self._set("BlackLevel", float(clipped["brightness_percent"]))
        exposure_us, gain = self._get("ExposureTime"), self._get("Gain")
        return CameraSettings(
            clipped["exposure_ms"] if exposure_us is None else float(exposure_us) / _US_PER_MS,
            clipped["gain"] if gain is None else float(gain),
            clipped["brightness_percent"],
        )

    def limits(self) -> dict[str, tuple[float, float]]:
        """[lowest, highest] of the settings that the camera bounds."""
        with self._answering():
            return self._limits()

    def _limits(self) -> dict[str, tuple[float, float]]:
        found = {}
        for name, feature, unit in (
            ("exposure_ms", "ExposureTime", _US_PER_MS),
            ("gain", "Gain", 1.0),
            ("brightness_percent", "BlackLevel", 1.0),
        ):
            node = self._node(feature)
            if node is not None:
                found[name] = (float(node.min) / unit, float(node.max) / unit)
        return found

    def trigger_by_software(self, line: str) -> None:
        """One exposure now, then back to ``line``.

        Raises:
            CameraLostError: it does not answer, or its trigger input cannot be selected again.
        """
        with self._answering():
            self._set("TriggerSource", "Software")
            command = self._node("TriggerSoftware")
            if command is not None:
                command.execute()
            if not self._set("TriggerSource", line):
                raise CameraLostError(f"the camera did not go back to its trigger input {line}")

    def check_alive(self) -> None:
        """Read a register of the camera itself, because the library may answer from its cache.

        Raises:
            CameraLostError: it does not answer.
        """
        with self._answering():
            sign = next((name for name in _SIGNS if self._node(name) is not None), None)
            if sign is not None:
                self._node(sign).execute()
                return
            width = self._node("Width")
            width.node.invalidate_node()
            _ = width.value

    # ---- pictures ----

    def fetch(self, timeout_s: float) -> CameraFrame | None:
        """The next complete picture with its id, or None after ``timeout_s``; harvesters skips incomplete ones.

        Raises:
            CameraLostError: the camera or its producer does not answer.
        """
        # not under the lock: a command must not wait for a picture
        with _as_camera_lost():
            buffer = self._acquirer.try_fetch(timeout=timeout_s)
            return None if buffer is None else self._taken(buffer)

    def _taken(self, buffer: Any) -> CameraFrame:
        try:
            pixels = self._pixels(buffer.payload.components[0])
            # only the camera's clock tells when it was exposed
            camera_ns = self._clock.believed(_time_ns(buffer), mono_ns())
            return CameraFrame(pixels, self._frame_id(buffer), exposure_start_ns=0, camera_ns=camera_ns)
        finally:
            buffer.queue()

    def _pixels(self, part: Any) -> NDArray[Any]:
        channels = int(round(part.num_components_per_pixel))
        shape = (part.height, part.width) if channels == 1 else (part.height, part.width, channels)
        pixels = part.data.reshape(shape)
        return np.array(pixels[..., :3] if channels > 1 else pixels, order="C")

    def _frame_id(self, buffer: Any) -> int:
        self._own_id += 1
        try:
            return int(buffer.module.frame_id)
        except GenTLError:
            self.counts_frames = False
            return self._own_id

    def grab(self) -> NDArray[Any]:
        """The next picture of a camera that runs freely.

        Raises:
            SweepscopeError: none arrives.
        """
        deadline_s = time.monotonic() + _GRAB_S
        while time.monotonic() < deadline_s:
            frame = self.fetch(_FETCH_S)
            if frame is not None:
                return frame.pixels
        raise SweepscopeError(f"the camera has sent no picture for {_GRAB_S:.0f} s: look at its cable and its power")


class GenicamCamera:
    """One frame for each edge of the TRIGGER wire, in the order of exposure, with the camera's own counter."""

    def __init__(self, config: CameraConfig) -> None:
        self._line = config.trigger
        self._device = GenicamDevice(config)
        self._sink: CameraSink = lambda _event: None
        self._armed = False
        self._snaps = 0
        self._settings: CameraSettings | None = None
        self._failure: CameraLostError | None = None
        """What a command from another thread came upon; the thread that reads looks after it."""
        self._reading = ReaderThread("genicam-camera", self._serve)

    def open(self, sink: CameraSink) -> CameraInfo:
        """Connect and wait for triggers."""
        self._sink = sink
        frame_format = self._device.open(self._line)
        limits = self._device.limits()
        self._reading.begin()
        return CameraInfo(kind="genicam", format=frame_format, limits=limits)

    def close(self) -> None:
        """Disconnect; idempotent."""
        self._armed = False
        self._reading.end()
        self._device.close()

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings; returns those in effect."""
        taken = self._device.configure(settings)
        self._settings = taken
        return taken

    def arm(self) -> None:
        """Deliver hardware-triggered frames; no old frame waits, because the thread reads all the time."""
        self._snaps = 0
        self._armed = True

    def disarm(self) -> None:
        """Discard frames from now on."""
        self._armed = False

    def snap(self) -> None:
        """One exposure by software."""
        self._snaps += 1
        try:
            self._device.trigger_by_software(self._line)
        except CameraLostError as error:
            self._snaps, self._failure = 0, error
            raise

    def _serve(self) -> None:
        heard_s = time.monotonic()
        while not self._reading.ending:
            try:
                frame = self._device.fetch(_FETCH_S)
                if frame is not None:
                    heard_s = time.monotonic()
                    self._deliver(frame)
                elif time.monotonic() - heard_s > _QUIET_S:
                    self._device.check_alive()
                    heard_s = time.monotonic()
                if self._failure is not None:
                    raise self._failure
            except SweepscopeError as error:
                self._reconnect(error)
                heard_s = time.monotonic()

    def _deliver(self, frame: CameraFrame) -> None:
        if self._armed or self._snaps:
            self._snaps = max(0, self._snaps - 1)
            self._sink(frame)

    def _reconnect(self, error: Exception) -> None:
        """Report the camera as gone, reconnect, restore its settings, and report it as back."""
        self._snaps = 0
        logger.error("the camera is gone: %s", in_words(error))
        self._sink(CameraGone(in_words(error)))

        def again() -> None:
            self._device.close()
            self._device.open(self._line)
            if self._settings is not None:
                self._device.configure(self._settings)

        if self._reading.until_back(again, (SweepscopeError,)):
            # settings commands were refused meanwhile
            self._failure = None
            self._sink(CameraGone("", back=True))


@contextmanager
def _as_camera_lost() -> Iterator[None]:
    """Turns any error of the vendors' libraries into :class:`CameraLostError`."""
    try:
        yield
    except _ERRORS as error:
        raise CameraLostError(f"the camera does not answer: {in_words(error)}") from error


def in_words(error: Exception) -> str:
    """First line of a library's error text, without its source file and line."""
    first = (str(error).strip().splitlines() or [""])[0]
    return first.partition(" (file ")[0] or type(error).__name__


def _time_ns(buffer: Any) -> int:
    """The camera's clock at the exposure; 0 where it has none."""
    try:
        return int(buffer.timestamp) * NS_PER_S // int(buffer.timestamp_frequency)
    except (AttributeError, ZeroDivisionError, *_ERRORS):
        return 0


def _producers(named: str) -> list[Path]:
    """The producers to load.

    Raises:
        ConfigError: none is named or found.
    """
    if named:
        path = home_resolved(named, "camera.producer")
        if not path.is_file():
            raise ConfigError(f"camera.producer = {named!r} is no file: give the maker's .cti")
        return [path]
    folders = [Path(part) for part in os.environ.get(_PATH, "").split(os.pathsep) if part]
    found = sorted(path for folder in folders if folder.is_dir() for path in folder.glob("*.cti"))
    if not found:
        raise ConfigError(
            f"no GenTL producer: install the camera maker's, then set camera.producer to its .cti (or {_PATH})"
        )
    return found
