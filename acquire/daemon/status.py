"""The status board: everything that the rest of the system may know of the rig, in one message."""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec

from acquire.activities.runner import Interlude
from acquire.cameras.protocol import CameraInfo, CameraSettings
from acquire.contract.config.load import LoadedConfig
from acquire.contract.messaging.messages import FaultReport, Status
from acquire.contract.states import State
from acquire.contract.units import NS_PER_S, steps_to_um
from acquire.daemon.commands.control import Control
from acquire.stages.protocol import StageInfo, StageStatus

from .frame_sender import FrameSender
from .lamp_timer import LampTimer
from .preview_publisher import PreviewLane
from .rates import Rate
from .scan_runner import RunningScan

MAX_FAULTS = 32
"""Faults that the board keeps; the oldest acknowledged ones go first."""


@dataclass
class Board:
    """What is shown between and during scans. The last scan stays on it until the next begins."""

    config: LoadedConfig
    state: State = State.DISCONNECTED
    message: str = ""
    faults: list[FaultReport] = field(default_factory=list)
    last: Status = field(default_factory=lambda: Status(state=State.DISCONNECTED))
    _rate: Rate = field(default_factory=Rate)
    _started_ns: int = 0

    def __post_init__(self) -> None:
        rig = self.config.rig
        self.time_scale = rig.simulation.time_scale if rig.stage.kind == "simulated" else 1.0
        self.lamp = LampTimer(rig.lamp.warm_up_s * self.time_scale)

    def scan_started(self, now_ns: int) -> None:
        """A new scan begins: its clock starts, faults that were seen go."""
        self._started_ns = now_ns
        self._rate = Rate()
        self.faults = [fault for fault in self.faults if not fault.acknowledged]
        self.message = ""

    def shows(self, fault: FaultReport) -> bool:
        """The same fault stands there and nobody has seen it yet."""
        return any(
            (other.code, other.happened, other.acknowledged) == (fault.code, fault.happened, False)
            for other in self.faults
        )

    def add_fault(self, fault: FaultReport, now_ns: int) -> None:
        """Show a fault; the same fault again replaces its older report."""
        kept = [other for other in self.faults if other.code != fault.code or other.happened != fault.happened]
        self.faults = [*kept, msgspec.structs.replace(fault, at_mono_ns=now_ns)][-MAX_FAULTS:]

    def acknowledge(self, code: str) -> int:
        """Mark faults as seen (all, where ``code`` is empty); returns how many."""
        hit = [fault for fault in self.faults if not fault.acknowledged and code in ("", fault.code)]
        self.faults = [msgspec.structs.replace(f, acknowledged=True) if f in hit else f for f in self.faults]
        return len(hit)

    def status(
        self,
        now_ns: int,
        *,
        stage: StageStatus,
        stage_info: StageInfo,
        camera_info: CameraInfo,
        settings: CameraSettings,
        lane: FrameSender,
        scan: RunningScan | None,
        interlude: Interlude,
        control: Control,
        preview: PreviewLane,
    ) -> Status:
        """The message as it stands now."""
        limits, travel = self.config.rig.limits, self.config.rig.stage
        facts = Status(
            state=self.state,
            position_steps=stage.position_steps,
            position_um=steps_to_um(stage.position_steps, travel.um_per_microstep),
            position_trusted=stage.position_trusted,
            zero_id=stage.zero_id,
            travel_steps=(travel.travel_min_steps, travel.travel_max_steps),
            stage_kind=stage_info.kind,
            stage_version=stage_info.version[:128],
            camera_kind=camera_info.kind,
            lamp_on=stage.lamp_on,
            camera=msgspec.structs.asdict(settings),
            format=camera_info.format,
            writer_alive=lane.alive(now_ns, round(limits.writer_lost_s * NS_PER_S)),
            counters=lane.counters | preview.counters | interlude.counters,
            faults=self.faults,
            message=self.message,
            control=control.holder(now_ns),
            activity=interlude.doing,
            activity_share=interlude.share,
            proposal=interlude.proposal,
            lamp_warm_s=self.lamp.update(now_ns, on=stage.lamp_on),
            camera_limits=camera_info.limits,
        )
        self.last = self._with_scan(facts, scan, now_ns) if scan is not None else self._with_last(facts)
        return self.last

    def _with_last(self, facts: Status) -> Status:
        """Between scans the account of the last one stays."""
        kept = (
            "scan_uid", "scan_path", "plan", "outcome", "expected", "triggered", "received", "committed", "durable",
            "retaken", "missing", "elapsed_s", "window",
        )  # fmt: skip
        counters = self.last.counters | facts.counters
        return msgspec.structs.replace(facts, counters=counters, **{name: getattr(self.last, name) for name in kept})

    def _with_scan(self, facts: Status, scan: RunningScan, now_ns: int) -> Status:
        sweep, window = scan.sweep, scan.sweep.window
        committed = len(window.committed)
        rate_hz = self._rate.update(committed, now_ns)
        return msgspec.structs.replace(
            facts,
            state=sweep.state,
            scan_uid=scan.prepared.start.scan_uid,
            scan_path=str(scan.prepared.folder),
            plan=scan.prepared.start.plan,
            hold_reason=sweep.hold_reason or "",
            outcome=sweep.outcome,
            expected=sweep.count,
            triggered=sweep.intake.counters["triggered"],
            received=sweep.intake.counters["received"],
            committed=committed,
            durable=sweep.durable,
            retaken=sweep.retaken,
            missing=sweep.count - committed if scan.done else 0,
            credit=max(0, window.free()),
            window=window.slots,
            rate_hz=rate_hz,
            eta_s=(sweep.count - committed) / rate_hz if rate_hz > 0 and not sweep.paused else None,
            elapsed_s=(now_ns - self._started_ns) / NS_PER_S,
            counters=facts.counters | sweep.counters | {"live_drops": scan.live_drops},
        )
