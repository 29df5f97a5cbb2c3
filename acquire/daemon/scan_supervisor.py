"""The one scan that may run: begins it, follows it to its end, and reports a writer or a disk that falls behind."""

from __future__ import annotations

import msgspec

from acquire.activities.preview_publisher import PreviewPublisher
from acquire.activities.runner import ActivityRunner
from acquire.cameras.protocol import CameraGone
from acquire.contract.config.model import LimitsConfig
from acquire.contract.faults import report, unfinished
from acquire.contract.messaging.lanes import Sender
from acquire.contract.plan import SweepPlan
from acquire.contract.process.logs import follow_scan
from acquire.contract.states import HoldReason, Outcome, State, outcome_words
from acquire.contract.units import NS_PER_S
from acquire.rigs.base import Rig
from acquire.rigs.status_board import StatusBoard
from acquire.sweep.events import StopRequested, Tick

from .frame_sender import FrameSender
from .rates import Rate
from .resume import UnfinishedScan
from .scan_runner import RunningScan
from .scan_setup import PreparedScan


class ScanStatus(msgspec.Struct, frozen=True):
    """What the status message shows of the running or last scan; empty before the first. See ``Status``."""

    scan_uid: str = ""
    scan_path: str = ""
    plan: SweepPlan | None = None
    hold_reason: str = ""
    outcome: str = ""
    expected: int = 0
    triggered: int = 0
    received: int = 0
    committed: int = 0
    durable: int = 0
    retaken: int = 0
    missing: int = 0
    credit: int = 0
    window: int = 0
    rate_hz: float = 0.0
    eta_s: float | None = None
    elapsed_s: float = 0.0


class ScanSupervisor:
    """One thread calls everything."""

    def __init__(
        self,
        rig: Rig,
        limits: LimitsConfig,
        frames: FrameSender,
        live: Sender,
        board: StatusBoard,
        runner: ActivityRunner,
        preview: PreviewPublisher,
    ) -> None:
        self._rig, self._limits, self._frames, self._live = rig, limits, frames, live
        self._board, self._runner, self._preview = board, runner, preview
        self.running: RunningScan | None = None
        self.camera_away = ""
        """Why the camera is away; empty while it is there."""
        self._last = ScanStatus()
        self._last_counters: dict[str, int] = {}
        self._rate = Rate()
        self._began_ns = 0
        self._writer_lost = self._disk_slow = False

    def begin(self, prepared: PreparedScan, now_ns: int) -> None:
        """Begin a scan that was checked."""
        self._board.begin_scan(prepared.folder.name)
        self._rate, self._began_ns, self._disk_slow = Rate(), now_ns, False
        self._runner.end_for_scan(now_ns)
        self.running = RunningScan(
            prepared,
            self._rig,
            self._frames,
            self._live,
            on_fault=self._board.fault,
            on_message=self._board.say,
            on_view=self._preview.keep,
        )
        follow_scan(prepared.start.scan_uid)
        self.running.begin(now_ns)
        self._board.enter(State.ARMED)
        for warning in prepared.warnings:
            self._board.say(warning)

    def note_camera(self, event: CameraGone) -> None:
        """The camera is away or back, whether or not a scan runs."""
        self.camera_away = "" if event.back else event.detail or "it does not answer"

    def tick(self, now_ns: int) -> bool:
        """Let time pass for the scan that runs; True once it is over: then call :meth:`finish`."""
        assert self.running is not None
        self.running.handle(Tick(self._rig.stage.status().no_alarm_ns), now_ns)
        self._watch_writer(self.running, now_ns)
        if not self.running.done:
            self._board.enter(self.running.sweep.state)
        return self.running.done

    def finish(self, now_ns: int) -> None:
        """Let go of a scan that is over, and report its outcome."""
        assert self.running is not None
        sweep, last = self.running.sweep, self.status(now_ns)
        self._last_counters = self.counters
        self._last = msgspec.structs.replace(last, hold_reason="", credit=0, rate_hz=0.0, eta_s=None)
        self.running.close()
        self.running = None
        for state in (State.FINISHING, State.IDLE):
            self._board.enter(state)
        reason = f" ({sweep.reason})" if sweep.reason else ""
        self._board.say(outcome_words(sweep.outcome, last.committed, last.expected) + reason)
        self._board.end_scan()

    def note_unfinished(self, scan: UnfinishedScan) -> None:
        """At the start: show the interrupted sweep as the last scan, and as a fault until it is seen or resumed."""
        committed, expected = scan.committed, scan.plan.count
        self._last = ScanStatus(
            scan_uid=scan.scan_uid,
            scan_path=str(scan.folder),
            plan=scan.plan,
            outcome=Outcome.INTERRUPTED,
            expected=expected,
            committed=committed,
            missing=expected - committed,
        )
        self._board.fault(unfinished(scan.folder.name, committed, expected))

    def interrupt(self, now_ns: int) -> None:
        """The daemon ends: so does the scan, with an end message."""
        if self.running is not None:
            self._board.fault(report("F24", **self.progress))
            self.running.handle(StopRequested(Outcome.ABORTED, "F24 the service was told to stop"), now_ns)

    def close(self) -> None:
        """Release the scan without an end; the writer keeps what it has."""
        if self.running is not None:
            self.running.close()

    @property
    def progress(self) -> dict[str, int]:
        """Committed and expected frames, as fault reports name them."""
        assert self.running is not None
        return {"committed": len(self.running.sweep.window.committed), "expected": self.running.sweep.count}

    def _watch_writer(self, scan: RunningScan, now_ns: int) -> None:
        """Report a writer that is silent while frames wait for it, and a disk that is slower than the camera."""
        waiting = bool(scan.sweep.window.unacked)
        lost = waiting and not self._frames.alive(now_ns, round(self._limits.writer_lost_s * NS_PER_S))
        if lost and not self._writer_lost:
            self._board.fault(report("F03", **self.progress))
        self._writer_lost = lost
        slow = scan.sweep.hold_reason is HoldReason.NO_CREDIT and not lost
        if slow and not self._disk_slow:
            self._board.fault(report("F04"))
        # reported once in a scan: a slow disk makes every window run empty
        self._disk_slow |= slow

    @property
    def state(self) -> State:
        """The state of the rig that belongs to the scan; its own where none runs."""
        return self._board.state if self.running is None else self.running.sweep.state

    @property
    def counters(self) -> dict[str, int]:
        """Of the running or last scan."""
        if self.running is None:
            return self._last_counters
        return self.running.sweep.counters | {"live_drops": self.running.live_drops}

    def status(self, now_ns: int) -> ScanStatus:
        """The scan as it is now; between scans the last one."""
        if self.running is None:
            return self._last
        scan, sweep, window = self.running, self.running.sweep, self.running.sweep.window
        committed = len(window.committed)
        rate_hz = self._rate.update(committed, now_ns)
        return ScanStatus(
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
            retaken=len(sweep.retaken),
            missing=sweep.count - committed if scan.done else 0,
            # check frames need no credit: they may be before the last commit
            credit=min(max(0, window.free()), window.slots),
            window=window.slots,
            rate_hz=rate_hz,
            eta_s=(sweep.count - committed) / rate_hz if rate_hz > 0 and not sweep.paused else None,
            elapsed_s=(now_ns - self._began_ns) / NS_PER_S,
        )
