"""Measures how long the picture needs to settle after a step, and proposes settle_ms."""

from __future__ import annotations

import queue
import time
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from acquire.cameras.protocol import CameraFrame, CameraSettings
from acquire.contract.config.model import RigConfig
from acquire.contract.errors import SweepscopeError
from acquire.rigs.base import Rig
from acquire.stages.protocol import Alarm, Moved, Segment, SegmentDone, StageEvent, Stopped

DELAYS_MS = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)
REST_MS = 500.0
"""A picture that was taken so long after a step has settled."""
REPEATS = 3
TOLERANCE = 1.1
"""A difference up to so many times the one between two settled pictures is noise."""
_WAIT_S = 30.0
_LOOK_S = 0.05


class SettleReport(msgspec.Struct, frozen=True):
    """What was measured."""

    delays_ms: tuple[float, ...]
    differences: tuple[float, ...]
    """Mean absolute difference from a settled picture, in counts; the largest of the repeats."""
    noise: float
    """The same between two settled pictures."""
    settle_ms: float | None
    """Proposal; None where the picture did not settle within the longest delay."""


def propose_settle_ms(delays_ms: Sequence[float], differences: Sequence[float], noise: float) -> float | None:
    """The shortest delay from which on no picture differs more than noise does; None if the last one still does."""
    proposal = None
    for delay_ms, difference in sorted(zip(delays_ms, differences, strict=True), reverse=True):
        if difference > TOLERANCE * noise:
            break
        proposal = delay_ms
    return proposal


class SettleMeasurement:
    """Steps to one position again and again and takes pictures after different delays."""

    def __init__(self, rig: Rig, config: RigConfig, position_steps: int) -> None:
        self._rig, self._config, self._position = rig, config, position_steps
        self._frames: queue.Queue[CameraFrame] = queue.Queue()
        self._events: queue.Queue[StageEvent] = queue.Queue()

    def run(self) -> SettleReport:
        """Measure; opens and closes stage and camera.

        Raises:
            SweepscopeError: a device refuses, stops by itself, or no picture comes.
        """
        camera = self._config.camera
        self._rig.camera.open(lambda found: self._frames.put(found) if isinstance(found, CameraFrame) else None)
        try:
            self._rig.camera.configure(CameraSettings(camera.exposure_ms, camera.gain, camera.brightness_percent))
            self._rig.open_stage(self._events.put)
            try:
                return self._measure()
            finally:
                self._rig.stage.close()
        finally:
            self._rig.camera.close()

    def _measure(self) -> SettleReport:
        if not self._rig.stage.status().position_trusted:
            self._rig.stage.home()
            self._wait(Moved)
        self._rig.set_lamp(on=True)
        self._rig.camera.arm()
        rest = self._look(REST_MS)
        noise = max(_difference(rest, self._look(REST_MS)) for _ in range(REPEATS))
        worst = tuple(max(_difference(rest, self._look(delay)) for _ in range(REPEATS)) for delay in DELAYS_MS)
        self._rig.set_lamp(on=False)
        return SettleReport(DELAYS_MS, worst, noise, propose_settle_ms(DELAYS_MS, worst, noise))

    def _look(self, delay_ms: float) -> NDArray[Any]:
        """One picture, so long after a step of the sweep's pitch."""
        pitch = self._config.sweep.steps_per_frame
        segment = Segment(
            self._position,
            pitch,
            1,
            settle_ms=delay_ms,
            dwell_ms=self._config.camera.exposure_ms,
            run_up_steps=pitch,
        )
        self._rig.stage.begin_segment(segment, 0)
        self._wait(SegmentDone)
        try:
            return self._frames.get(timeout=self._config.camera.frame_timeout_ms / 1000).pixels
        except queue.Empty:
            raise SweepscopeError("no picture came: is the trigger wired, and the camera set to it?") from None

    def _wait(self, kind: type[StageEvent]) -> None:
        deadline_s = time.monotonic() + _WAIT_S
        while time.monotonic() < deadline_s:
            self._rig.stage.keep_alive()
            try:
                event = self._events.get(timeout=_LOOK_S)
            except queue.Empty:
                continue
            if isinstance(event, kind):
                return
            if isinstance(event, (Alarm, Stopped)):
                raise SweepscopeError(f"the stage stopped by itself: {event}")
        raise SweepscopeError(f"the stage did not come to rest within {_WAIT_S:.0f} s")


def _difference(first: NDArray[Any], second: NDArray[Any]) -> float:
    return float(np.mean(np.abs(first.astype(np.float32) - second.astype(np.float32))))
