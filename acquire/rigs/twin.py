"""The digital twin: the real firmware and the real serial driver under the simulated optics.

The camera exposes at edges of the emulated TRIGGER pin and sees the stage where the STEP edges have moved it;
the lamp is the emulated LAMP pin. ``twin.jsonl`` beside the scan records every trigger at the pins.
"""

from __future__ import annotations

import json
import logging
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path

import msgspec

from acquire.cameras.simulated import SimulatedCamera
from acquire.contract.config.model import RigConfig, StageConfig
from acquire.contract.plan import SweepPlan
from acquire.contract.scan_data.dataset_names import PINS_NAME
from acquire.stages.protocol import Alarm, StageEvent, StageInfo, StageSink, Triggered
from acquire.stages.uno.config import switch_position_steps
from acquire.stages.uno.emulator import Emulator, TriggerEdge, build_firmware
from acquire.stages.uno.stage import UnoStage
from acquire.stages.uno.wire_format import LEASE_MAX_MS

from .simulated import RenderedRig

logger = logging.getLogger(__name__)

_LIMIT_AT = -300
_LAMP_S = 2.0


class PairedEdges:
    """Joins each trigger report of the firmware with the edge at the pin; then the camera exposes.

    The frame must never reach the daemon before the report of its trigger, which the serial line delivers a little
    later than the edge.
    """

    def __init__(self, expose: Callable[[float, int, float, int], None], zero_at: int, um_per_microstep: float) -> None:
        """``expose`` takes the true position at mid-exposure (microsteps), the time (ns), the travel during the
        exposure (microsteps), and the time by the controller's clock (ns), which the simulated camera uses as its own.
        """
        self._expose, self._zero_at, self._um = expose, zero_at, um_per_microstep
        self._lock = threading.Lock()
        self._edges: deque[tuple[TriggerEdge, bool]] = deque()
        self._reported: deque[Triggered] = deque()
        self._record: Path | None = None
        self.differences = 0
        """Shots whose counted and true position differed."""

    def record_to(self, path: Path | None) -> None:
        """Write every pair to this file from now on, each at once; None: to no file."""
        with self._lock:
            self._record = path
            self._write("", "w")

    def edge(self, edge: TriggerEdge, *, delivered: bool) -> None:
        """TRIGGER rose; ``delivered`` is False where an injected fault loses it on its way to the camera."""
        with self._lock:
            self._edges.append((edge, delivered))
            self._pair()

    def reported(self, event: Triggered) -> None:
        """The firmware reports a trigger."""
        with self._lock:
            self._reported.append(event)
            self._pair()

    def forget(self) -> None:
        """The firmware has restarted: reports that are missing will never come."""
        with self._lock:
            self._edges.clear()
            self._reported.clear()

    def _pair(self) -> None:
        while self._edges and self._reported:
            (edge, delivered), event = self._edges.popleft(), self._reported.popleft()
            position_steps = edge.position_steps - self._zero_at
            self.differences += position_steps != event.position_steps
            pair = {
                "trigger_id": event.trigger_id,
                "counted_steps": event.position_steps,
                "true_steps": position_steps,
                "counted_cycles": event.trigger_cycles,
                "true_cycles": edge.cycles,
                "delivered": delivered,
            }
            self._write(json.dumps(pair) + "\n", "a")
            if delivered:
                half_way = 0.0 if event.position_um is None else event.position_um / self._um - event.position_steps
                self._expose(position_steps + half_way, event.at_mono_ns, 2 * abs(half_way), event.fired_ns)

    def _write(self, text: str, mode: str) -> None:
        """A full disk ends the record, not the serial session, in whose thread this runs."""
        if self._record is None:
            return
        try:
            with self._record.open(mode, encoding="utf-8") as record:
                record.write(text)
        except OSError as error:
            logger.error("the record of the pins ends: %s", error)  # noqa: TRY400
            self._record = None


class TwinStage(UnoStage):
    """The serial driver on its own emulator."""

    def __init__(self, config: StageConfig, pace: float, camera: SimulatedCamera) -> None:
        self._emulator = Emulator(*build_firmware(), pace=pace, limit_at=_LIMIT_AT)
        lease_ms = min(config.motion_lease_ms * max(pace, 1.0), LEASE_MAX_MS)
        super().__init__(msgspec.structs.replace(config, port=self._emulator.port, motion_lease_ms=lease_ms))
        self._camera = camera
        zero_at = _LIMIT_AT - switch_position_steps(config)
        self.pairs = PairedEdges(camera.on_trigger, zero_at, config.um_per_microstep)
        self._lamp_moved = threading.Condition()

    def open(self, sink: StageSink) -> StageInfo:
        """Connect the pins to the camera, then open the driver."""

        def tell(event: StageEvent) -> None:
            sink(event)
            if isinstance(event, Triggered):
                self.pairs.reported(event)
            elif isinstance(event, Alarm) and event.code == "F13":
                self.pairs.forget()

        self._emulator.watch(
            lambda edge: self.pairs.edge(edge, delivered=True),
            self._on_lamp,
            lambda edge: self.pairs.edge(edge, delivered=False),
        )
        info = super().open(tell)
        return msgspec.structs.replace(info, version=f"{info.version} (emulated)")

    def _on_lamp(self, on: bool) -> None:
        with self._lamp_moved:
            self._camera.lamp_on = on
            self._lamp_moved.notify_all()

    def set_lamp(self, *, on: bool) -> None:
        """Switch the lamp and wait until its pin has followed, so that the next picture is taken in its light."""
        super().set_lamp(on=on)
        with self._lamp_moved:
            if not self._lamp_moved.wait_for(lambda: self._camera.lamp_on == on, timeout=_LAMP_S):
                logger.warning("the lamp's pin did not follow within %s s", _LAMP_S)

    def close(self) -> None:
        """End driver and emulator; idempotent."""
        super().close()
        self.pairs.record_to(None)
        self._emulator.close()


class TwinRig(RenderedRig):
    """The simulated camera over the emulated stage, whose pins switch the lamp and record each trigger."""

    stage: TwinStage

    def __init__(self, config: RigConfig) -> None:
        # real time at a time scale of 1, else as fast as the durations are scaled, as far as the emulator can
        pace = 1.0 / config.simulation.time_scale
        super().__init__(config, lambda camera: TwinStage(config.stage, pace, camera))

    def write_truth(self, folder: Path, plan: SweepPlan) -> threading.Thread:
        """Write the ground truth, and record the pins from now on."""
        self.stage.pairs.record_to(folder / PINS_NAME)
        return super().write_truth(folder, plan)
