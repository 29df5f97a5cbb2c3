"""The simulated stage: moves, segments and triggers in a thread of its own, on the same protocol as the firmware."""

from __future__ import annotations

import math
import threading
import time
import uuid
from collections.abc import Callable

from acquire.contract.config_model import StageConfig
from acquire.contract.errors import CommandRefusedError

from .protocol import (
    Held,
    Moved,
    Segment,
    SegmentDone,
    StageInfo,
    StageSink,
    StageStatus,
    Stopped,
    Triggered,
)

TriggerLine = Callable[[int, int], None]
"""Called with (position in microsteps, CLOCK_MONOTONIC ns) at each trigger, after it was reported."""

_SLICE_S = 0.02
_SHORTEST_WAIT_S = 50e-6


class _StopRequestedError(Exception):
    """Unwinds the running activity."""


class SimulatedStage:
    """A stage that is exact and homed from the start. ``time_scale`` shortens its motion, never its order."""

    def __init__(self, config: StageConfig, line: TriggerLine, *, time_scale: float = 1.0) -> None:
        self._config = config
        self._line = line
        self._time_scale = time_scale
        self._changed = threading.Condition()
        self._activity: Callable[[], None] | None = None
        self._thread: threading.Thread | None = None
        self._sink: StageSink = lambda _event: None
        self._position = 0
        self._zero_id = uuid.uuid4().hex[:8]
        self._triggers = 0
        self._granted = -1
        self._lamp_on = False
        self._holding = self._stopping = self._closing = False
        self._next_trigger_s = 0.0

    # ---- protocol ----

    def open(self, sink: StageSink) -> StageInfo:
        """Start the thread; events go to ``sink``."""
        self._sink = sink
        self._closing = False
        self._thread = threading.Thread(target=self._serve, name="simulated-stage", daemon=True)
        self._thread.start()
        return StageInfo(kind="simulated", version="1", boot_id=uuid.uuid4().hex[:8], has_limit_switch=True)

    def close(self) -> None:
        """End motion and thread; idempotent."""
        with self._changed:
            self._closing = self._stopping = True
            self._lamp_on = False
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(timeout=5)
            self._thread = None

    def status(self) -> StageStatus:
        """Where the stage is now."""
        return StageStatus(
            position_steps=self._position,
            position_trusted=True,
            zero_id=self._zero_id,
            moving=self._activity is not None,
            triggers=self._triggers,
            lamp_on=self._lamp_on,
        )

    def move_to(self, position_steps: int) -> None:
        """Start a move within the soft limits."""
        self._check_travel(position_steps)
        self._start(lambda: self._move_and_tell(position_steps))

    def home(self) -> None:
        """Go to the limit switch, which is zero, and make a new zero_id."""
        self._start(self._home)

    def zero_here(self) -> None:
        """Call the present position zero."""
        self._start(self._zero)

    def check_limit(self) -> None:
        """Touch the limit again: a simulated stage loses no steps."""
        self._start(self._touch)

    def begin_segment(self, segment: Segment, may_trigger_through: int) -> int:
        """Start a segment in step mode; returns the trigger_id of its first shot."""
        if segment.mode != "step":
            raise CommandRefusedError("the simulated stage sweeps in step mode only: set sweep.mode = 'step'")
        self._check_travel(segment.first_steps)
        self._check_travel(segment.first_steps + (segment.count - 1) * segment.pitch_steps)
        first_id = self._triggers
        self._granted = may_trigger_through
        self._start(lambda: self._shoot(segment))
        return first_id

    def grant(self, may_trigger_through: int) -> None:
        """Raise the absolute credit."""
        with self._changed:
            self._granted = max(self._granted, may_trigger_through)
            self._changed.notify_all()

    def hold(self) -> None:
        """Hold before the next trigger."""
        with self._changed:
            self._holding = True
            self._changed.notify_all()

    def resume(self) -> None:
        """Go on."""
        with self._changed:
            self._holding = False
            self._changed.notify_all()

    def stop(self) -> None:
        """End the activity; nothing happens when there is none."""
        with self._changed:
            self._stopping = self._activity is not None
            self._changed.notify_all()

    def set_lamp(self, *, on: bool) -> None:
        """Switch the lamp."""
        self._lamp_on = on

    def keep_alive(self) -> None:
        """Nothing to renew: the stage lives in the host."""

    # ---- activities, in the stage's thread ----

    def _start(self, activity: Callable[[], None]) -> None:
        with self._changed:
            if self._thread is None:
                raise CommandRefusedError("the stage is not open")
            if self._activity is not None:
                raise CommandRefusedError("the stage is moving: wait for it, or stop it")
            self._holding = self._stopping = False
            self._activity = activity
            self._changed.notify_all()

    def _serve(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closing or self._activity is not None)
                activity = self._activity
            if self._closing or activity is None:
                return
            try:
                activity()
            except _StopRequestedError:
                self._idle()
                self._sink(Stopped(self._position, position_trusted=True))

    def _idle(self) -> None:
        """Ready for the next activity before the last one is reported: the report may start it."""
        with self._changed:
            self._activity = None
            self._stopping = False

    def _move_and_tell(self, position_steps: int) -> None:
        self._travel(position_steps)
        self._tell_moved()

    def _home(self) -> None:
        self._travel(self._config.travel_min_steps)
        self._zero_id = uuid.uuid4().hex[:8]
        self._tell_moved()

    def _zero(self) -> None:
        self._position = 0
        self._zero_id = uuid.uuid4().hex[:8]
        self._tell_moved()

    def _touch(self) -> None:
        self._travel(self._config.travel_min_steps)
        self._tell_moved(steps_lost=0)

    def _tell_moved(self, steps_lost: int | None = None) -> None:
        self._idle()
        self._sink(Moved(self._position, position_trusted=True, zero_id=self._zero_id, steps_lost=steps_lost))

    def _shoot(self, segment: Segment) -> None:
        direction = 1 if segment.pitch_steps >= 0 else -1
        low, high = self._config.travel_min_steps, self._config.travel_max_steps
        self._travel(min(max(segment.first_steps - direction * segment.run_up_steps, low), high))
        for shot_index in range(segment.count):
            self._travel(segment.first_steps + shot_index * segment.pitch_steps)
            self._wait(segment.settle_ms / 1000)
            self._wait_for_credit(shot_index)
            self._fire(shot_index)
            self._next_trigger_s = time.monotonic() + segment.period_ms / 1000 * self._time_scale
            self._wait(segment.dwell_ms / 1000)
        self._idle()
        self._sink(SegmentDone(self._position))

    def _fire(self, shot_index: int) -> None:
        at_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
        trigger_id, self._triggers = self._triggers, self._triggers + 1
        self._sink(Triggered(trigger_id, shot_index, self._position, trigger_cycles=at_ns, at_mono_ns=at_ns))
        self._line(self._position, at_ns)

    def _wait_for_credit(self, shot_index: int) -> None:
        """Wait for credit and for the end of a hold, then until the period since the last trigger is over."""
        with self._changed:
            told = False
            while not self._stopping and (self._holding or self._granted < shot_index):
                if self._holding and not told:
                    told = True
                    self._sink(Held("requested", self._position))
                self._changed.wait(timeout=1.0)
        self._sleep_until(self._next_trigger_s)

    def _travel(self, target_steps: int) -> None:
        """Move at the profile's speed; a stop is obeyed within a slice."""
        start, started_s = self._position, time.monotonic()
        duration_s = self._duration_s(abs(target_steps - start)) * self._time_scale
        while (elapsed_s := time.monotonic() - started_s) < duration_s - _SHORTEST_WAIT_S:
            self._position = start + round((target_steps - start) * elapsed_s / duration_s)
            self._sleep_until(min(started_s + duration_s, time.monotonic() + _SLICE_S))
        self._raise_if_stopped()
        self._position = target_steps

    def _duration_s(self, distance_steps: int) -> float:
        """Time of a trapezoidal move (seconds of a real stage)."""
        rate, acceleration = self._config.max_rate_steps_per_s, self._config.acceleration_steps_per_s2
        ramp_steps = rate * rate / acceleration
        if distance_steps < ramp_steps:
            return 2 * math.sqrt(distance_steps / acceleration)
        return rate / acceleration + distance_steps / rate

    def _wait(self, duration_s: float) -> None:
        self._sleep_until(time.monotonic() + duration_s * self._time_scale)

    def _sleep_until(self, deadline_s: float) -> None:
        remaining_s = deadline_s - time.monotonic()
        if remaining_s > _SHORTEST_WAIT_S:
            with self._changed:
                self._changed.wait_for(lambda: self._stopping, timeout=remaining_s)
        self._raise_if_stopped()

    def _raise_if_stopped(self) -> None:
        if self._stopping:
            raise _StopRequestedError

    def _check_travel(self, position_steps: int) -> None:
        low, high = self._config.travel_min_steps, self._config.travel_max_steps
        if not low <= position_steps <= high:
            raise CommandRefusedError(f"{position_steps} microsteps is outside the travel {low}..{high}")
