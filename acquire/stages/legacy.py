"""Stage on the original one-byte sketch: four commands, no replies, so position and triggers cannot be verified.

Protocol (9600 baud 8N1): ``1`` and ``0`` set STEP high and low, ``2`` and ``3`` set DIR low (out) and high (in).
Steps, triggers and frames are therefore counted by the host alone, and the report says so.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import serial

from acquire.contract.config.model import StageConfig
from acquire.contract.errors import CommandRefusedError
from acquire.contract.process.clocks import mono_ns
from acquire.stages.uno.ports import choose_port, open_port

from .host_driven import HostDrivenStage
from .protocol import Moved, Segment, SegmentDone, StageInfo, StageSink, StageStatus, Stopped, Triggered

BAUD = 9600
_BYTE_S = 10 / BAUD
_DEAD_S = 1.5
"""After opening the port the controller's loader listens for so long: what is sent meanwhile is lost."""
_CHUNK_STEPS = 10
STEP_BYTES = b"10"
OUTWARD, INWARD = b"2", b"3"


class LegacyStage(HostDrivenStage):
    """Steps by bytes. It has no TRIGGER wire: the host passes each shot on to the camera.

    The position is trusted only from ``zero_here`` until the port is closed: a restart of the controller or a lost step
    cannot be detected.
    """

    def __init__(
        self,
        config: StageConfig,
        *,
        opener: Callable[[], serial.Serial] | None = None,
        dead_time_s: float = _DEAD_S,
    ) -> None:
        super().__init__(config, "legacy-stage")
        self._opener = opener or (lambda: open_port(choose_port(config.port), BAUD))
        self._dead_time_s = dead_time_s
        self._port: serial.Serial | None = None
        self._zeros = 0
        self._ready_s = 0.0

    # ---- protocol ----

    def open(self, sink: StageSink) -> StageInfo:
        """Open the port; the first motion waits for the controller's dead time."""
        self._port = self._opener()
        self._ready_s = time.monotonic() + self._dead_time_s
        self._begin_serving(sink)
        return StageInfo(kind="legacy", version="original sketch", counts_triggers=False)

    def close(self) -> None:
        """Stop, STEP low, disconnect; idempotent."""
        self._end_serving()
        if self._port is not None:
            self._port.close()
            self._port = None

    def status(self) -> StageStatus:
        """What the host has counted."""
        return StageStatus(
            position_steps=self._position,
            position_trusted=self._zeros > 0,
            zero_id=f"legacy-{self._zeros}" if self._zeros else "",
            moving=self._activity is not None,
            triggers=self._triggers,
        )

    def move_to(self, position_steps: int, rate_steps_per_s: float = 0.0) -> None:
        """Start a move; its bytes bound the speed at 480 microsteps per second."""
        if self._zeros:
            self._check_travel(position_steps)
        self._start(lambda: self._move(position_steps, rate_steps_per_s))

    def home(self) -> None:
        """Refused: there is no limit switch."""
        raise CommandRefusedError("the original controller has no limit switch: jog to the near end, then zero")

    def zero_here(self) -> None:
        """Call the present position zero."""
        self._start(self._zero)

    def begin_segment(self, segment: Segment, may_trigger_through: int) -> int:
        """Start a segment in step mode."""
        if segment.mode != "step":
            raise CommandRefusedError("the original controller cannot sweep in fly mode: set sweep.mode = 'step'")
        if not self._zeros:
            raise CommandRefusedError("the position is not trusted: jog to the near end, then zero")
        self._check_travel(segment.first_steps)
        self._check_travel(segment.first_steps + (segment.count - 1) * segment.pitch_steps)
        first_id = self._triggers
        self._granted = may_trigger_through
        self._start(lambda: self._shoot(segment))
        return first_id

    def set_lamp(self, *, on: bool) -> None:
        """The original controller has no lamp output: it is switched by hand."""

    def keep_alive(self) -> None:
        """Steps come from the host: when it stops, they stop."""

    # ---- activities, in the stage's thread ----

    def _ended_early(self, error: OSError | None) -> Stopped:
        if error is None:
            return Stopped(self._position, position_trusted=self._zeros > 0)
        self._zeros = 0
        return Stopped(self._position, position_trusted=False, reason=f"the port failed: {error}")

    def _moved(self, steps_lost: int | None = None) -> Moved:
        return Moved(self._position, self._zeros > 0, self.status().zero_id, steps_lost)

    def _touch(self) -> None:
        """Without a limit switch, report no number of lost steps."""
        self._end_with(self._moved())

    def _move(self, position_steps: int, rate_steps_per_s: float) -> None:
        self._travel(position_steps, rate_steps_per_s)
        self._end_with(self._moved())

    def _zero(self) -> None:
        self._position = 0
        self._zeros += 1
        self._end_with(self._moved())

    def _travel(self, target_steps: int, rate_steps_per_s: float = 0.0) -> None:
        """Write steps in small chunks at the pace of the serial line, so that a stop takes effect soon."""
        assert self._port is not None
        self._wait(self._ready_s - time.monotonic())
        outward = target_steps >= self._position
        step_s = max(len(STEP_BYTES) * _BYTE_S, 1 / rate_steps_per_s if rate_steps_per_s else 0.0)
        chunk_steps = max(1, min(_CHUNK_STEPS, int(_CHUNK_STEPS * len(STEP_BYTES) * _BYTE_S / step_s)))
        if target_steps != self._position:
            self._port.write(OUTWARD if outward else INWARD)
        while self._position != target_steps:
            count = min(chunk_steps, abs(target_steps - self._position))
            self._port.write(STEP_BYTES * count)
            self._position += count if outward else -count
            self._wait(count * step_s)

    def _shoot(self, segment: Segment) -> None:
        self._travel(self._run_up_from(segment.first_steps, segment.pitch_steps, segment.run_up_steps))
        for shot_index in range(segment.count):
            self._wait_for_credit(shot_index)
            self._travel(segment.first_steps + shot_index * segment.pitch_steps)
            self._wait(segment.settle_ms / 1000)
            self._shot(shot_index)
            self._wait(max(segment.dwell_ms, segment.period_ms) / 1000)
        self._end_with(SegmentDone(self._position))

    def _shot(self, shot_index: int) -> None:
        at_ns = mono_ns()
        trigger_id, self._triggers = self._triggers, self._triggers + 1
        self._sink(Triggered(trigger_id, shot_index, self._position, at_mono_ns=at_ns))
