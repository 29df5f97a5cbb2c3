"""A GenICam camera with a trigger input, as far as the driver sees one: in the place of harvesters' ``Harvester``.

It exposes at each pulse of its line while it listens to it, else freely, counts frames, has a clock of its own, and can
lose a frame, spoil one, miss a pulse, vanish with or without a word, and come back with its counters at their start.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from genicam.genapi import AccessException
from genicam.gentl import IoException
from numpy.typing import NDArray

LINE = "Line1"
SERIAL = "T-1"
FIRST_ID = 900
CLOCK_AHEAD_NS = 5_000_000_000
GONE = "no device"
_FREE_S = 0.002

Picture = Callable[[float], NDArray[Any]]


class Node:
    """One feature; every access reaches the camera."""

    def __init__(self, camera: TriggeredCamera, value: Any, low: float = 0.0, high: float = 1e9) -> None:
        self._camera, self._value = camera, value
        self.min, self.max = low, high
        self.node = self

    @property
    def value(self) -> Any:
        self._camera.reach()
        return self._value

    @value.setter
    def value(self, value: Any) -> None:
        self._camera.reach()
        self._value = value

    def execute(self) -> None:
        self._camera.reach()
        self._value()

    def invalidate_node(self) -> None:
        """Nothing is remembered."""


class TriggeredCamera:
    """The camera itself. ``pulse`` is its trigger input; ``picture`` what it sees of a stage at some microsteps."""

    def __init__(self, picture: Picture, width: int, height: int, *, has_clock: bool = True) -> None:
        self.picture, self._has_clock = picture, has_clock
        self.plugged, self.silent = True, False
        """``silent``: the producer tells nothing of a cable that was pulled."""
        self.still_listed = False
        """The producer lists it while it is away, and fails when it is opened."""
        self.unseen: set[int] = set()
        self.lost: set[int] = set()
        self.incomplete: set[int] = set()
        """Pulses (counted from 0) that it does not see; whose frame is lost on its way; comes without some lines."""
        self.where = lambda: 0.0
        self.words_late_s = 0.0
        """So long after its pulse a trigger is told of, by the stage that stands in for the real one."""
        self.pulses = self.looked = self.opened = self.fetches = 0
        self.produced: dict[int, NDArray[Any]] = {}
        """What it exposed at each pulse that it saw."""
        self._lock = threading.Lock()
        self._frame_id = FIRST_ID
        self.filled: queue.Queue[Any] = queue.Queue()
        self.streaming = False
        self.nodes = {
            "Width": Node(self, width), "Height": Node(self, height), "PixelFormat": Node(self, "Mono8"),
            "AcquisitionMode": Node(self, "Continuous"), "TriggerSelector": Node(self, "FrameStart"),
            "TriggerSource": Node(self, "Line0"), "TriggerMode": Node(self, "Off"),
            "TriggerSoftware": Node(self, self._software), "TimestampLatch": Node(self, lambda: None),
            "ExposureTime": Node(self, 10_000.0, 20.0, 1e6), "Gain": Node(self, 0.0, 0.0, 24.0),
        }  # fmt: skip

    def reach(self) -> None:
        """A command over the cable."""
        if not self.plugged:
            raise AccessException(f"{GONE} (file 'x.cpp', line 7)")

    def pulse(self, position_steps: float, at_ns: int, _travel_steps: float = 0.0) -> None:
        """The TRIGGER wire rose while the stage was at ``position_steps``, at ``at_ns``."""
        number, self.pulses = self.pulses, self.pulses + 1
        waits = self.nodes["TriggerMode"]._value == "On" and self.nodes["TriggerSource"]._value == LINE
        if self.plugged and waits and number not in self.unseen:
            self.produced[number] = self._expose(position_steps, at_ns, number)

    def run(self) -> None:
        """One more picture, if it runs freely."""
        if self.plugged and self.streaming and self.nodes["TriggerMode"]._value == "Off":
            time.sleep(_FREE_S)
            self._expose(self.where(), time.clock_gettime_ns(time.CLOCK_MONOTONIC), -1)

    def _software(self) -> None:
        if self.nodes["TriggerSource"]._value == "Software":
            self._expose(self.where(), time.clock_gettime_ns(time.CLOCK_MONOTONIC), -1)

    def _expose(self, position_steps: float, at_ns: int, number: int) -> NDArray[Any]:
        with self._lock:
            frame_id, self._frame_id = self._frame_id, self._frame_id + 1
            pixels = self.picture(position_steps)
            if number not in self.lost and self.streaming:
                self.filled.put((frame_id, at_ns, pixels, number not in self.incomplete))
        return pixels

    def vanish(self, *, silent: bool = False) -> None:
        """Its cable is pulled."""
        self.plugged, self.silent = False, silent

    def come_back(self) -> None:
        """Plugged in again: counters start anew, and what was under way is gone."""
        with self._lock:
            self._frame_id, self.streaming = 0, False
            while not self.filled.empty():
                self.filled.get_nowait()
        self.nodes["TriggerMode"]._value, self.nodes["TriggerSource"]._value = "Off", "Line0"
        self.plugged = True

    def harvester(self) -> Harvester:
        """Stands where the driver makes its ``Harvester``."""
        return Harvester(self)

    def buffer(self, frame_id: int, at_ns: int, pixels: NDArray[Any]) -> SimpleNamespace:
        """As harvesters hands it over: the pixels are gone when it is queued again."""
        height, width = pixels.shape
        data = pixels.copy().reshape(-1)
        part = SimpleNamespace(num_components_per_pixel=1.0, height=height, width=width, data=data)
        return SimpleNamespace(
            payload=SimpleNamespace(components=[part]), module=SimpleNamespace(frame_id=frame_id),
            timestamp=at_ns + CLOCK_AHEAD_NS if self._has_clock else 0, timestamp_frequency=1_000_000_000,
            queue=lambda: data.fill(0),
        )  # fmt: skip


class Harvester:
    """The part of harvesters' class that the driver uses; also its ``ImageAcquirer``."""

    min_num_buffers = 1

    def __init__(self, camera: TriggeredCamera) -> None:
        self._camera = camera
        self.device_info_list: list[Any] = []
        nodes = SimpleNamespace(**camera.nodes, has_node=camera.nodes.__contains__)
        self.remote_device = SimpleNamespace(node_map=nodes)

    def add_file(self, _path: str) -> None:
        """A producer."""

    def update(self) -> None:
        self._camera.looked += 1
        if self._camera.plugged or self._camera.still_listed:
            self.device_info_list = [SimpleNamespace(serial_number=SERIAL)]

    def create(self, index: int) -> Harvester:
        assert self.device_info_list[index].serial_number == SERIAL
        if not self._camera.plugged:
            raise IoException(GONE)
        return self

    def start(self) -> None:
        self._camera.opened += 1
        self._camera.streaming = True

    def stop(self) -> None:
        self._camera.streaming = False

    def destroy(self) -> None:
        """The acquirer's end."""

    def reset(self) -> None:
        """The harvester's end."""

    def try_fetch(self, *, timeout: float) -> SimpleNamespace | None:
        self._camera.fetches += 1
        if not self._camera.plugged and not self._camera.silent:
            raise IoException(GONE)
        self._camera.run()
        try:
            frame_id, at_ns, pixels, whole = self._camera.filled.get(timeout=timeout)
        except queue.Empty:
            return None
        # harvesters passes over an incomplete one
        return self._camera.buffer(frame_id, at_ns, pixels) if whole else None
