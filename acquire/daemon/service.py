"""The rig daemon: owns stage, camera and lamp, runs one sweep at a time, and never loses a frame that it has seen.

One loop in one thread takes what devices, writer and clients say and lets the pure sweep decide.
"""

from __future__ import annotations

import logging
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zmq

from acquire.activities.runner import Interlude
from acquire.cameras.protocol import CameraFrame, CameraGone, CameraSettings
from acquire.contract.config.load import LoadedConfig
from acquire.contract.faults import in_one_line, report
from acquire.contract.messaging.lanes import Sender, bind
from acquire.contract.messaging.messages import Command, FaultReport, Status
from acquire.contract.process.clocks import Clock, MonotonicClock, epoch_utc_ns
from acquire.contract.process.log_throttle import Threshold
from acquire.contract.process.logs import follow_scan
from acquire.contract.process.notify import Notifier
from acquire.contract.process.run_dir import lock_service, prepare_run_dir
from acquire.contract.states import HoldReason, Outcome, State, outcome_words, transition
from acquire.contract.units import NS_PER_S
from acquire.daemon.commands.command_server import CommandLane
from acquire.daemon.commands.control import Control
from acquire.daemon.commands.scan_commands import Desk
from acquire.rigs.base import Rig
from acquire.rigs.build import build_rig
from acquire.stages.protocol import StageEvent
from acquire.sweep.events import StopRequested, Tick

from .clock_watch import TimeWatch
from .event_queue import Inbox
from .frame_sender import FrameSender
from .preview_publisher import PreviewLane
from .scan_runner import RunningScan
from .scan_setup import PreparedScan
from .status import Board

logger = logging.getLogger(__name__)
POLL_MS = 10
LEAST_NOISE_BLOCKS = 10
"""So many damaged blocks on the stage's line are told of; a few come with plugging in."""


class Daemon:
    """The loop and what it holds."""

    def __init__(self, config: LoadedConfig, run_dir: Path, rig: Rig, clock: Clock | None = None) -> None:
        self.config, self.rig = config, rig
        self.clock = clock or MonotonicClock()
        self.board = Board(config)
        self.scan: RunningScan | None = None
        self.ending = False
        self._notifier = Notifier()
        self._inbox = Inbox()
        self._context: zmq.Context[Any] = zmq.Context()
        self.lane = FrameSender(bind(self._context, zmq.ROUTER, run_dir, "frames"))
        self.live = Sender(bind(self._context, zmq.PUB, run_dir, "live"))
        self._status = Sender(bind(self._context, zmq.PUB, run_dir, "status"))
        self.preview = PreviewLane(bind(self._context, zmq.XPUB, run_dir, "preview"))
        self._run_dir = run_dir
        self.interlude = Interlude(self)
        self.control = Control()
        self.camera_away = ""
        """Why the camera is gone; empty while it is there."""
        self._desk = Desk(self)
        self._status_due_ns = 0
        self._changed = True
        self._unreadable, self._noisy = Threshold(1), Threshold(LEAST_NOISE_BLOCKS)
        self._writer_lost = self._disk_slow = False
        self._status_next_ns = 0
        self._time = TimeWatch()

    # ---- life ----

    def open(self) -> None:
        """Connect the devices."""
        camera = self.config.rig.camera
        self.camera_info = self.rig.camera.open(self._inbox.put)
        self.settings = self.rig.camera.configure(
            CameraSettings(camera.exposure_ms, camera.gain, camera.brightness_percent)
        )
        self.stage_info = self.rig.open_stage(self._inbox.put)
        # who finds this lane finds a rig that answers: nothing said to it waits for devices to open
        socket = bind(self._context, zmq.ROUTER, self._run_dir, "command")
        self._commands = CommandLane(socket, self.clock, self.config.rig.limits.command_s, self._do)
        self.enter(State.IDLE)
        self.say(f"ready: {self.stage_info.kind} stage, {self.camera_info.kind} camera")

    def run(self) -> None:
        """Serve until told to end, then bring the running sweep to its end within the stop time-out."""
        poller = zmq.Poller()
        for source in (self.lane.socket, self._commands.socket, self._inbox.fileno()):
            poller.register(source, zmq.POLLIN)
        deadline_ns: int | None = None
        self._notifier.ready(self.board.message)
        while True:
            poller.poll(POLL_MS)
            self._turn()
            self._notifier.alive()
            if not self.ending:
                continue
            now_ns = self.clock.now_ns()
            if deadline_ns is None:
                deadline_ns = now_ns + round(self.config.rig.limits.stop_s * NS_PER_S)
                self._notifier.stopping()
                self._interrupt(now_ns)
            if self.scan is None or now_ns > deadline_ns:
                break

    def close(self) -> None:
        """Bring everything to rest; each step is tried even if the one before failed."""
        steps: tuple[Callable[[], object], ...] = (
            self.rig.stage.stop,
            self.rig.camera.disarm,
            lambda: self.scan.close() if self.scan is not None else None,
            self.rig.stage.close,
            self.rig.camera.close,
            self._publish_last,
            lambda: self._context.destroy(linger=200),
            self._inbox.close,
        )
        for step in steps:
            try:
                step()
            except Exception:  # noqa: BLE001 - the outermost end: one failing step must not keep the next from running
                logger.exception("a step of the cleanup failed")

    # ---- what clients may use ----

    def say(self, text: str) -> None:
        """Put a line on the status board and into the log."""
        logger.info(text)
        self.board.message = text
        self._changed = True

    def fault(self, fault: FaultReport) -> None:
        """Show a fault until the operator has seen it."""
        if not self.board.shows(fault):
            # a disk that fails says so for each frame that waits
            logger.error(in_one_line(fault))
        self.board.add_fault(fault, self.clock.now_ns())
        self.board.message = in_one_line(fault)
        self._changed = True

    def enter(self, state: State) -> None:
        """Change the rig's state by the table."""
        if state != self.board.state:
            self.board.state = transition(self.board.state, state)
            self._changed = True

    def begin_scan(self, prepared: PreparedScan) -> None:
        """Start a scan that was checked."""
        now_ns = self.clock.now_ns()
        self.board.scan_started(now_ns)
        self._disk_slow = False
        self.interlude.end_for_sweep(now_ns)
        self.scan = RunningScan(
            prepared,
            self.rig,
            self.lane,
            self.live,
            on_fault=self.fault,
            on_message=self.say,
            on_view=self.preview.keep,
        )
        follow_scan(prepared.start.scan_uid)
        self.scan.begin(now_ns)
        self.enter(State.ARMED)
        for warning in prepared.warnings:
            self.say(warning)

    # ---- one turn of the loop ----

    def _turn(self) -> None:
        now_ns = self.clock.now_ns()
        self._watch_time(now_ns)
        for event in self._inbox.take_all():
            self._take_device_event(event, now_ns)
        for lane_event in self.lane.poll(now_ns):
            if self.scan is not None:
                self.scan.handle(lane_event, now_ns)
                self._changed = True
        self._changed |= self._commands.serve()
        self._watch_messages()
        if self.scan is not None:
            self.scan.handle(Tick(self.rig.stage.status().no_alarm_ns), now_ns)
            self._watch_writer(self.scan, now_ns)
            self._follow_scan()
        else:
            self.interlude.tick(now_ns)
        self.rig.stage.keep_alive()
        self._publish_status(now_ns)
        # pictures come last: whatever the stage waits for has been said
        self.preview.poll()
        self.preview.flush(now_ns, self.camera_info.format, self.interlude.rate_hz)

    def _take_device_event(self, event: StageEvent | CameraFrame | CameraGone, now_ns: int) -> None:
        self._changed = True
        if isinstance(event, CameraGone):
            self.camera_away = "" if event.back else event.detail or "it does not answer"
        if self.scan is None:
            self.interlude.take(event, now_ns)
        elif not self.interlude.is_stale(event, now_ns):
            self.scan.handle(event, now_ns)

    def _follow_scan(self) -> None:
        assert self.scan is not None
        sweep = self.scan.sweep
        if not self.scan.done:
            self.enter(sweep.state)
            return
        self._publish_status(self.clock.now_ns(), force=True)
        committed, outcome, reason = len(sweep.window.committed), sweep.outcome, sweep.finish.reason
        self.scan.close()
        self.scan = None
        for state in (State.FINISHING, State.IDLE):
            self.enter(state)
        self.say(outcome_words(outcome, committed, sweep.count) + (f" ({reason})" if reason else ""))

    def _watch_writer(self, scan: RunningScan, now_ns: int) -> None:
        """A writer that says nothing while frames wait for it is lost, and the operator is told once."""
        waiting = bool(scan.sweep.window.unacked)
        lost = waiting and not self.lane.alive(now_ns, round(self.config.rig.limits.writer_lost_s * NS_PER_S))
        if lost and not self._writer_lost:
            self.fault(report("F03", committed=len(scan.sweep.window.committed), expected=scan.sweep.count))
        self._writer_lost = lost
        slow = scan.sweep.hold_reason is HoldReason.NO_CREDIT and not lost
        if slow and not self._disk_slow:
            self.fault(report("F04"))
        # told once in a scan: a disk that is slower than the camera is so at every window
        self._disk_slow |= slow

    def _watch_time(self, now_ns: int) -> None:
        """A frozen process and a jump of the wall clock do no harm, but explain a gap in a log: they are noted."""
        for code, seconds in self._time.update(now_ns, epoch_utc_ns()):
            # freezing matters only to a sweep; one that was not running has nothing to tell
            if self.scan is not None:
                facts = {"committed": len(self.scan.sweep.window.committed), "expected": self.scan.sweep.count}
                self.fault(report(code, seconds=f"{seconds:.0f}", **facts))
            else:
                logger.info("%s: %.1f s", code, seconds)

    def _watch_messages(self) -> None:
        """Tell of messages and blocks that nobody could read: the first, and when there are ten times as many."""
        count = self._commands.malformed + self.lane.counters["malformed"]
        if self._unreadable.reached(count):
            self.fault(report("F20", count=count))
        damaged = self.rig.stage.status().damaged_blocks
        if self._noisy.reached(damaged):
            self.fault(report("F11", detail=f"{damaged} blocks came damaged"))

    def _interrupt(self, now_ns: int) -> None:
        """The service ends: so does the sweep, with an honest end."""
        if self.scan is not None:
            self.fault(report("F24", committed=len(self.scan.sweep.window.committed), expected=self.scan.sweep.count))
            self.scan.handle(StopRequested(Outcome.ABORTED, "F24 the service was told to stop"), now_ns)

    # ---- clients ----

    def _do(self, command: Command) -> dict[str, Any]:
        self.control.hear(command.name, command.client, self.clock.now_ns())
        return self._desk.serve(command.name, command.args, command.client)

    # ---- status ----

    def _publish_status(self, now_ns: int, *, force: bool = False) -> None:
        hz = self.config.rig.limits.status_hz
        if not force and now_ns < self._status_due_ns and not (self._changed and now_ns >= self._status_next_ns):
            return
        self._changed = False
        self._status_due_ns = now_ns + round(NS_PER_S / hz)
        self._status_next_ns = now_ns + NS_PER_S // 25
        self._status.send(self.current_status(now_ns))

    def current_status(self, now_ns: int) -> Status:
        """The rig as it is now."""
        return self.board.status(
            now_ns,
            stage=self.rig.stage.status(),
            stage_info=self.stage_info,
            camera_info=self.camera_info,
            settings=self.settings,
            lane=self.lane,
            scan=self.scan,
            interlude=self.interlude,
            control=self.control,
            preview=self.preview,
        )

    def _publish_last(self) -> None:
        self.board.state = State.DISCONNECTED
        self._publish_status(self.clock.now_ns(), force=True)


def run_daemon(config: LoadedConfig, run_dir: Path) -> None:
    """The daemon service: locks, binds, opens the rig, serves until SIGTERM or SIGINT.

    Raises:
        AlreadyRunningError: another daemon holds the lock.
        ConfigError: a socket or a driver that cannot be.
    """
    lock = lock_service(prepare_run_dir(run_dir), "daemon")
    daemon = Daemon(config, run_dir, build_rig(config.rig))

    def end(_signal: int, _frame: object) -> None:
        daemon.ending = True

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end)
    try:
        daemon.open()
        daemon.run()
    finally:
        daemon.close()
        lock.release()
