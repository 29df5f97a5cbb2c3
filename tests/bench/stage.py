"""Measures the stage on the emulated firmware: round trip, step rate, jitter at the pins, time of whole sweeps."""

from __future__ import annotations

import math
import queue
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from acquire.contract.config.model import StageConfig
from acquire.contract.errors import SweepscopeError
from acquire.stages.protocol import Alarm, Moved, Segment, SegmentDone, StageEvent
from acquire.stages.uno.emulator import Emulator, EmulatorError, build_firmware
from acquire.stages.uno.stage import UnoStage
from acquire.stages.uno.wire_format import Cmd, LampBody

CYCLES_PER_US = 16
_LIMIT_AT = -300
_WAIT_S = 120.0
_RATES = (5_000, 10_000, 15_000, 20_000)
_BUSY_ROUNDS = 3


@dataclass(frozen=True)
class Edge:
    """One rising edge at a pin."""

    kind: str
    position: int
    cycles: int


class _Rig:
    """A homed stage on the emulator, which logs every edge."""

    def __init__(self, built: tuple[Path, Path], folder: Path, config: StageConfig, pace: float) -> None:
        self.emulator = Emulator(*built, pace=pace, limit_at=_LIMIT_AT)
        self.config = msgspec.structs.replace(config, kind="uno", port=self.emulator.port)
        self._events: queue.Queue[StageEvent] = queue.Queue()
        self._log = folder / "edges"
        self.stage = UnoStage(self.config)
        self.stage.open(self._events.put)
        self.stage.home()
        self.wait(Moved)

    def wait(self, kind: type[StageEvent], *, busy: bool = False) -> None:
        """Until this event; ``busy`` keeps the line full meanwhile."""
        deadline_s = time.monotonic() + _WAIT_S
        while time.monotonic() < deadline_s:
            self.stage.keep_alive()
            if busy:
                for _ in range(_BUSY_ROUNDS):
                    self.stage.diagnose()
            try:
                event = self._events.get(timeout=0.001 if busy else 0.02)
            except queue.Empty:
                continue
            if isinstance(event, Alarm):
                raise EmulatorError(f"the stage stopped by itself: {event.detail}")
            if isinstance(event, kind):
                return
        raise EmulatorError(f"no {kind.__name__} within {_WAIT_S:.0f} s")

    @contextmanager
    def edges(self) -> Iterator[list[Edge]]:
        """Rising edges while the block runs; filled at its end."""
        found: list[Edge] = []
        self.emulator.knob(f"log {self._log}")
        yield found
        self.emulator.knob("log off")
        for line in self._log.read_text(encoding="ascii").splitlines():
            kind, _number, position, cycles, _level = line.split()
            found.append(Edge(kind, int(position), int(cycles)))

    def move(self, target_steps: int, *, busy: bool = False) -> list[Edge]:
        """Move; the step edges."""
        with self.edges() as found:
            self.stage.move_to(target_steps)
            self.wait(Moved, busy=busy)
        return [edge for edge in found if edge.kind == "step"]

    def sweep(self, segment: Segment) -> list[Edge]:
        """Run a segment with full credit; the trigger edges."""
        with self.edges() as found:
            self.stage.begin_segment(segment, segment.count - 1)
            self.wait(SegmentDone)
        return [edge for edge in found if edge.kind == "trigger"]

    def close(self) -> None:
        """End stage and emulator."""
        self.stage.close()
        self.emulator.close()


def bench_stage(frames: int = 527, round_trips: int = 500) -> dict[str, Any]:
    """Measure the emulated stage.

    Args:
        frames: shots of the timed sweeps, pitch 3 microsteps.
        round_trips: commands for the round trip, at real time.

    Returns:
        Figures with their unit in the name; jitter is peak to peak, from cycle stamps at the pins.

    Raises:
        SweepscopeError: the AVR tools are missing, or something moved wrongly.
    """
    built = build_firmware()
    with tempfile.TemporaryDirectory(prefix="stage-bench-") as name:
        folder = Path(name)
        return {
            **_with_rig(built, folder, StageConfig(), 1.0, lambda rig: _round_trip(rig, round_trips)),
            **_step_rate(built, folder),
            **_with_rig(built, folder, StageConfig(motion_lease_ms=5000), 0.0, lambda rig: _sweeps(rig, frames)),
            **_with_rig(built, folder, _fast(20_000), 0.0, _fastest_fly),
        }


def _with_rig(built: tuple[Path, Path], folder: Path, config: StageConfig, pace: float, measure: Any) -> dict[str, Any]:
    rig = _Rig(built, folder, config, pace)
    try:
        figures: dict[str, Any] = measure(rig)
    finally:
        rig.close()
    return figures


def _round_trip(rig: _Rig, count: int) -> dict[str, Any]:
    times_ms = []
    for _ in range(count):
        started_s = time.perf_counter()
        rig.stage._link.ask(Cmd.LAMP, LampBody(0).pack())  # noqa: SLF001 - the shortest command with an answer
        times_ms.append((time.perf_counter() - started_s) * 1000)
    times_ms.sort()
    return {
        "round_trip_median_ms": round(statistics.median(times_ms), 2),
        "round_trip_p99_ms": round(times_ms[math.ceil(len(times_ms) * 0.99) - 1], 2),
    }


def _fast(rate: int) -> StageConfig:
    return StageConfig(
        max_rate_steps_per_s=rate, acceleration_steps_per_s2=200_000, motion_lease_ms=5000, travel_max_steps=40_000
    )


def _step_rate(built: tuple[Path, Path], folder: Path) -> dict[str, Any]:
    """The highest rate of the table at which a long move is exact, with the line kept full."""
    best: dict[str, Any] = {"highest_step_rate_per_s": 0}
    for rate in _RATES:
        try:
            best = _with_rig(built, folder, _fast(rate), 0.0, lambda rig, rate=rate: _steady(rig, rate))
        except SweepscopeError as error:
            return {**best, "above_it": str(error)}
    return best


def _steady(rig: _Rig, rate: int) -> dict[str, Any]:
    start = rig.emulator.state().position
    from_steps = rig.stage.status().position_steps
    edges = rig.move(30_000, busy=True)
    if len(edges) != 30_000 - from_steps or rig.emulator.state().position - start != len(edges):
        raise EmulatorError(f"{len(edges)} steps at the pin instead of {30_000 - from_steps}")
    steady = edges[len(edges) // 3 : len(edges) * 2 // 3]
    diagnosis = rig.stage.diagnose()
    return {
        "highest_step_rate_per_s": rate,
        "reached_rate_per_s": round(16_000_000 * (len(steady) - 1) / (steady[-1].cycles - steady[0].cycles)),
        "step_jitter_us": _jitter_us(steady),
        "longest_loop_us": diagnosis.loop_max_us,
        "stack_free_bytes": diagnosis.stack_free_min,
        "ram_bytes": diagnosis.ram_size,
    }


def _jitter_us(edges: list[Edge]) -> float:
    gaps = [later.cycles - earlier.cycles for earlier, later in zip(edges, edges[1:], strict=False)]
    return round((max(gaps) - min(gaps)) / CYCLES_PER_US, 2)


def _check_places(edges: list[Edge], segment: Segment, rig: _Rig) -> None:
    offset = rig.emulator.state().position - rig.stage.status().position_steps
    wanted = [segment.first_steps + j * segment.pitch_steps + offset for j in range(segment.count)]
    if [edge.position for edge in edges] != wanted:
        raise EmulatorError("a trigger was not at its microstep")


def _sweeps(rig: _Rig, frames: int) -> dict[str, Any]:
    config = rig.config
    step = Segment(0, 3, frames, "step", settle_ms=5.0, dwell_ms=30.0, run_up_steps=config.run_up_steps)
    fly = Segment(0, 3, frames, "fly", period_ms=1000 / 60, run_up_steps=config.run_up_steps)
    step_edges, fly_edges = rig.sweep(step), rig.sweep(fly)
    _check_places(step_edges, step, rig)
    _check_places(fly_edges, fly, rig)
    step_s, fly_s = _span_s(step_edges), _span_s(fly_edges)
    move_s = 2 * math.sqrt(3 / config.acceleration_steps_per_s2)
    step_bound_s = (frames - 1) * (move_s + 0.035)
    fly_bound_s = (frames - 1) / 60
    return {
        "frames": frames,
        "step_sweep_s": round(step_s, 3),
        "step_sweep_over_bound": round(step_s / step_bound_s, 3),
        "fly_sweep_s": round(fly_s, 3),
        "fly_sweep_over_bound": round(fly_s / fly_bound_s, 3),
        "fly_60_trigger_jitter_us": _jitter_us(fly_edges),
        "trigger_position_error_steps": 0,
    }


def _span_s(edges: list[Edge]) -> float:
    return (edges[-1].cycles - edges[0].cycles) / 1e6 / CYCLES_PER_US


def _fastest_fly(rig: _Rig) -> dict[str, Any]:
    """As many shots as the firmware remembers, at the highest speed that the table of rates and the pulse allow."""
    segment = Segment(3000, 6, 30, "fly", period_ms=6 / 20, run_up_steps=48)
    edges = rig.sweep(segment)
    _check_places(edges, segment, rig)
    return {
        "fastest_fly_frames_per_s": round(16_000_000 * 29 / (edges[-1].cycles - edges[0].cycles)),
        "fastest_fly_trigger_jitter_us": _jitter_us(edges),
    }
