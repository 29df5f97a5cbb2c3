"""How long the picture shakes after a step: measured on a rig that shakes by a known law."""

from __future__ import annotations

import math

import numpy as np
import pytest

from acquire.cameras.protocol import CameraFrame
from acquire.contract.config.model import RigConfig
from acquire.contract.errors import SweepscopeError
from acquire.rig_tools.settle_time import DELAYS_MS, SettleMeasurement, propose_settle_ms
from acquire.rigs.base import Rig
from acquire.stages.protocol import Alarm, SegmentDone, StageStatus


class ShakingRig(Rig):
    """Camera and stage in one: the picture is off by an amount that dies away with ``decay_ms``."""

    def __init__(self, decay_ms, *, frames=True, alarm=False):
        super().__init__(self, self)
        self.decay_ms, self.frames, self.alarm = decay_ms, frames, alarm
        self.sinks, self.lamp, self.closed = [], [], 0
        self.noise = np.random.default_rng(1)

    def open(self, sink):
        self.sinks.append(sink)

    def close(self):
        self.closed += 1

    def status(self):
        return StageStatus(0, True, "z", False, 0)

    def begin_segment(self, segment, may_trigger_through):
        camera, stage = self.sinks
        if self.alarm:
            stage(Alarm("F23", "the limit switch", 0, False))
            return
        shift = 20 * math.exp(-segment.settle_ms / self.decay_ms) if self.decay_ms else 0.0
        pixels = self.noise.normal(100 + shift, 2, (32, 32)).astype(np.float32)
        if self.frames:
            camera(CameraFrame(pixels, 0, 0))
        stage(SegmentDone(segment.first_steps))

    def set_lamp(self, *, on):
        self.lamp.append(on)

    def configure(self, _settings):
        pass

    arm = keep_alive = lambda self: None


def measure(rig, **config):
    return SettleMeasurement(rig, RigConfig(**config), 300).run()


def test_a_picture_that_never_shakes_needs_no_rest():
    assert measure(ShakingRig(0)).settle_ms == 0.0


def test_the_proposal_is_where_the_shaking_has_died_away():
    report = measure(ShakingRig(5.0))
    assert report.settle_ms in (20.0, 50.0)
    assert report.differences[0] > 5 * report.noise
    assert list(report.delays_ms) == list(DELAYS_MS)


def test_a_picture_that_does_not_come_to_rest_gets_no_proposal():
    assert propose_settle_ms((0, 10, 20), (9.0, 8.0, 7.0), 1.0) is None
    assert propose_settle_ms((0, 10, 20), (9.0, 1.0, 1.05), 1.0) == 10
    assert propose_settle_ms((0, 10, 20), (1.0, 9.0, 1.0), 1.0) == 20


def test_lamp_and_devices_are_at_rest_afterwards():
    rig = ShakingRig(0)
    measure(rig)
    assert rig.lamp == [True, False] and rig.closed == 2


def test_a_camera_that_gives_no_picture_and_a_stage_that_stops_are_named():
    from acquire.contract.config.model import CameraConfig

    rig = ShakingRig(0, frames=False)
    with pytest.raises(SweepscopeError, match="no picture"):
        measure(rig, camera=CameraConfig(frame_timeout_ms=20))
    assert rig.closed == 2
    with pytest.raises(SweepscopeError, match="limit switch"):
        measure(ShakingRig(0, alarm=True))
