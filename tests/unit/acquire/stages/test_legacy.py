"""The original controller on a pty: the bytes it gets, and what the driver does not claim to know."""

from __future__ import annotations

import os
import pty
import queue
import threading
import time
import tty

import pytest

from acquire.contract.config.model import StageConfig
from acquire.contract.errors import CommandRefusedError
from acquire.stages.legacy import LegacyStage
from acquire.stages.protocol import Moved, Segment, SegmentDone, Stopped, Triggered
from tests.waiting import next_of, wait_for


class Sketch:
    """The original sketch: counts rising STEP levels with the direction that it was told last."""

    def __init__(self):
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.position = self.step = 0
        self.direction = 1
        self.unknown = b""
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        while True:
            try:
                data = os.read(self.master, 1000)
            except OSError:
                return
            for byte in data:
                self._take(byte)
                if byte == ord("q"):
                    return

    def _take(self, byte):
        if byte == ord("1"):
            self.position += self.direction * (not self.step)
            self.step = 1
        elif byte == ord("0"):
            self.step = 0
        elif byte in b"23":
            self.direction = 1 if byte == ord("2") else -1
        else:
            self.unknown += bytes([byte])

    def close(self):
        os.write(self.slave, b"q")
        self._thread.join(timeout=5)
        os.close(self.slave)
        os.close(self.master)


class Rig:
    def __init__(self):
        self.sketch = Sketch()
        self.events = queue.Queue()
        config = StageConfig(kind="legacy", port=os.ttyname(self.sketch.slave))
        self.stage = LegacyStage(config, dead_time_s=0.0)
        self.info = self.stage.open(self.events.put)

    def next(self):
        return next_of(self.events)

    def zero(self):
        self.stage.zero_here()
        return self.next()


@pytest.fixture
def rig():
    found = Rig()
    yield found
    found.stage.close()
    found.sketch.close()


def settled(rig, position):
    return wait_for(lambda: rig.sketch.position == position, f"the place {position}", why=lambda: rig.sketch.position)


def test_moves_send_one_pulse_for_each_microstep_either_way(rig):
    rig.stage.move_to(25)
    assert rig.next().position_steps == 25
    assert settled(rig, 25)
    rig.stage.move_to(-4)
    rig.next()
    assert settled(rig, -4)
    assert rig.sketch.step == 0 and rig.sketch.unknown == b""


def test_a_move_goes_no_faster_than_it_is_told(rig):
    start_s = time.monotonic()
    rig.stage.move_to(20, 100.0)
    assert rig.next().position_steps == 20
    assert time.monotonic() - start_s >= 0.2


def test_the_position_is_not_trusted_until_it_is_zeroed(rig):
    assert not rig.info.counts_triggers
    rig.stage.move_to(10)
    moved = rig.next()
    assert isinstance(moved, Moved) and not moved.position_trusted
    with pytest.raises(CommandRefusedError, match="zero"):
        rig.stage.begin_segment(Segment(0, 3, 2), 1)
    assert rig.zero() == Moved(0, True, "legacy-1")
    with pytest.raises(CommandRefusedError, match="no limit switch"):
        rig.stage.home()


def test_a_segment_shoots_at_each_place_and_waits_for_credit(rig):
    rig.zero()
    rig.stage.begin_segment(Segment(6, 3, 3, run_up_steps=6), 1)
    assert [rig.next().shot_index for _ in range(2)] == [0, 1]
    assert rig.stage.status().moving
    rig.stage.grant(2)
    last = rig.next()
    assert isinstance(last, Triggered) and (last.trigger_id, last.position_steps) == (2, 12)
    assert rig.next() == SegmentDone(12)
    assert settled(rig, 12)


def test_a_stop_ends_a_long_move_early(rig):
    rig.zero()
    rig.stage.move_to(4000)
    rig.stage.stop()
    stopped = rig.next()
    assert isinstance(stopped, Stopped) and stopped.position_steps < 100
    assert settled(rig, stopped.position_steps)


def test_fly_mode_and_places_outside_the_travel_are_refused(rig):
    rig.zero()
    with pytest.raises(CommandRefusedError, match="fly"):
        rig.stage.begin_segment(Segment(0, 3, 2, mode="fly"), 1)
    with pytest.raises(CommandRefusedError, match=r"0\.\.4500"):
        rig.stage.move_to(-1)
