"""The simulated stage: moves, segments and triggers in a thread, behind the same protocol as the firmware."""

from __future__ import annotations

import math
import time
import uuid
from collections.abc import Callable

from acquire.contract.config.model import StageConfig
from acquire.contract.errors import CommandRefusedError
from acquire.contract.process.clocks import mono_ns

from .host_driven import HostDrivenStage
from .protocol import Moved, Segment, SegmentDone, StageInfo, StageSink, StageStatus, Stopped, Triggered

TriggerLine = Callable[[float, int, float], None]
"""Called at each trigger, after it was reported, with the position at mid-exposure in microsteps, CLOCK_MONOTONIC in
ns, and the way during the exposure in microsteps."""

_SLICE_S = 0.02
_SHORTEST_WAIT_S = 50e-6


class SimulatedStage(HostDrivenStage):
    """An exact stage, homed from the start. ``time_scale`` scales durations; the order of events stays the same."""

    def __init__(self, config: StageConfig, line: TriggerLine, *, time_scale: float = 1.0) -> None:
        super().__init__(config, "simulated-stage")
        self._line = line
        self._time_scale = time_scale
        self._zero_id = uuid.uuid4().hex[:8]
        self._lamp_on = False
        self._next_trigger_s = 0.0

    # ---- protocol ----

    def open(self, sink: StageSink) -> StageInfo:
        """Start the thread; events go to ``sink``."""
        self._begin_serving(sink)
        return StageInfo(
            kind="simulated",
            version="1",
            boot_id=uuid.uuid4().hex[:8],
            has_limit_switch=True,
            modes=("step", "fly"),
        )

    def close(self) -> None:
        """End motion and thread; idempotent."""
        self._end_serving()
        self._lamp_on = False

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

    def move_to(self, position_steps: int, rate_steps_per_s: float = 0.0) -> None:
        """Start a move within the soft limits."""
        self._check_travel(position_steps)
        self._start(lambda: self._move_and_tell(position_steps, rate_steps_per_s))

    def home(self) -> None:
        """Go to the limit switch, which is zero, and make a new zero_id."""
        self._start(self._home)

    def zero_here(self) -> None:
        """Call the present position zero."""
        self._start(self._zero)

    def begin_segment(self, segment: Segment, may_trigger_through: int) -> int:
        """Start a segment; returns the trigger_id of its first shot."""
        if segment.mode == "fly":
            self._check_speed(segment)
        self._check_travel(segment.first_steps)
        self._check_travel(segment.first_steps + (segment.count - 1) * segment.pitch_steps)
        first_id = self._triggers
        self._granted = may_trigger_through
        shoot = self._fly if segment.mode == "fly" else self._shoot
        self._start(lambda: shoot(segment))
        return first_id

    def set_lamp(self, *, on: bool) -> None:
        """Switch the lamp."""
        self._lamp_on = on

    def keep_alive(self) -> None:
        """Nothing to renew: the stage runs in the host."""

    # ---- activities, in the stage's thread ----

    def _ended_early(self, error: OSError | None) -> Stopped:
        return Stopped(self._position, position_trusted=True)

    def _moved(self, steps_lost: int | None = None) -> Moved:
        return Moved(self._position, position_trusted=True, zero_id=self._zero_id, steps_lost=steps_lost)

    def _move_and_tell(self, position_steps: int, rate_steps_per_s: float) -> None:
        self._travel(position_steps, rate_steps_per_s)
        self._end_with(self._moved())

    def _home(self) -> None:
        self._travel(self._config.travel_min_steps)
        self._zero_id = uuid.uuid4().hex[:8]
        self._end_with(self._moved())

    def _zero(self) -> None:
        self._position = 0
        self._zero_id = uuid.uuid4().hex[:8]
        self._end_with(self._moved())

    def _touch(self) -> None:
        self._travel(self._config.travel_min_steps)
        self._end_with(self._moved(steps_lost=0))

    def _shoot(self, segment: Segment) -> None:
        self._travel(self._run_up_from(segment.first_steps, segment.pitch_steps, segment.run_up_steps))
        for shot_index in range(segment.count):
            self._travel(segment.first_steps + shot_index * segment.pitch_steps)
            self._wait(segment.settle_ms / 1000 * self._time_scale)
            self._wait_for_credit(shot_index)
            self._sleep_until(self._next_trigger_s)
            self._fire(shot_index)
            self._next_trigger_s = time.monotonic() + segment.period_ms / 1000 * self._time_scale
            self._wait(segment.dwell_ms / 1000 * self._time_scale)
        self._end_with(SegmentDone(self._position))

    def _fly(self, segment: Segment) -> None:
        """Fly mode: constant speed, a trigger at each position; without credit it stops and approaches again."""
        period_s = segment.period_ms / 1000 * self._time_scale
        travel_steps = segment.pitch_steps * segment.dwell_ms / segment.period_ms
        next_s = None
        for shot_index in range(segment.count):
            place = segment.first_steps + shot_index * segment.pitch_steps
            if next_s is None or not self._has_credit(shot_index):
                self._wait_for_credit(shot_index, tell_no_credit=True)
                self._travel(self._run_up_from(place, segment.pitch_steps, segment.run_up_steps))
                next_s = time.monotonic() + period_s * segment.run_up_steps / abs(segment.pitch_steps)
            self._sleep_until(next_s)
            self._position = place
            self._fire(shot_index, travel_steps)
            # if this thread is late the stage is slower: two triggers are never closer than a period
            next_s = max(next_s, time.monotonic()) + period_s
        self._end_with(SegmentDone(self._position))

    def _check_speed(self, segment: Segment) -> None:
        """Fly mode needs a period that the stage's highest speed allows; else the segment is refused."""
        fastest = self._config.max_rate_steps_per_s
        if segment.period_ms <= 0 or abs(segment.pitch_steps) * 1000 / segment.period_ms > fastest:
            raise CommandRefusedError(
                f"{abs(segment.pitch_steps)} microsteps every {segment.period_ms:g} ms are faster than "
                f"stage.max_rate_steps_per_s = {fastest:g}: lower sweep.max_rate_hz"
            )

    def _fire(self, shot_index: int, travel_steps: float = 0.0) -> None:
        """Report the trigger, then expose; in fly mode the frame's position is that at mid-exposure."""
        at_ns = mono_ns()
        trigger_id, self._triggers = self._triggers, self._triggers + 1
        middle_steps = self._position + travel_steps / 2
        middle_um = middle_steps * self._config.um_per_microstep if travel_steps else None
        self._sink(Triggered(trigger_id, shot_index, self._position, at_ns, at_ns, middle_um, fired_ns=at_ns))
        self._line(middle_steps, at_ns, travel_steps)

    def _travel(self, target_steps: int, rate_steps_per_s: float = 0.0) -> None:
        """Move with the profile's speed, in time slices; a stop takes effect after a slice."""
        start, started_s = self._position, time.monotonic()
        duration_s = self._duration_s(abs(target_steps - start), rate_steps_per_s) * self._time_scale
        while (elapsed_s := time.monotonic() - started_s) < duration_s - _SHORTEST_WAIT_S:
            self._position = start + round((target_steps - start) * elapsed_s / duration_s)
            self._sleep_until(min(started_s + duration_s, time.monotonic() + _SLICE_S))
        self._raise_if_stopped()
        self._position = target_steps

    def _duration_s(self, distance_steps: int, rate_steps_per_s: float) -> float:
        """Time of a trapezoidal move (seconds of a real stage)."""
        rate, acceleration = self._config.max_rate_steps_per_s, self._config.acceleration_steps_per_s2
        rate = min(rate, rate_steps_per_s or rate)
        ramp_steps = rate * rate / acceleration
        if distance_steps < ramp_steps:
            return 2 * math.sqrt(distance_steps / acceleration)
        return rate / acceleration + distance_steps / rate

    def _sleep_until(self, deadline_s: float) -> None:
        """Wait until then; waits below the clock's resolution are skipped."""
        remaining_s = deadline_s - time.monotonic()
        self._wait(remaining_s if remaining_s > _SHORTEST_WAIT_S else 0.0)
