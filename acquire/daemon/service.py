"""The rig daemon: drives stage, camera and lamp, runs one scan at a time, and loses no frame that it has received.

One loop in one thread takes the events of devices, writer and clients. What a running scan does about them is decided
by the pure state machine in ``acquire.sweep``.
"""

from __future__ import annotations

import logging
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import zmq

from acquire.activities.preview_publisher import PreviewPublisher
from acquire.activities.runner import ActivityRunner
from acquire.cameras.protocol import CameraGone, CameraSettings
from acquire.contract.config.load import LoadedConfig
from acquire.contract.faults import report
from acquire.contract.messaging.lanes import Sender, bind
from acquire.contract.messaging.messages import Status
from acquire.contract.process.clocks import Clock, MonotonicClock, epoch_utc_ns
from acquire.contract.process.log_throttle import Threshold
from acquire.contract.process.notify import Notifier
from acquire.contract.process.run_dir import lock_service, prepare_run_dir
from acquire.contract.states import State
from acquire.contract.units import NS_PER_S, steps_to_um
from acquire.daemon.commands.activity_commands import ActivityCommands
from acquire.daemon.commands.command_server import CommandServer
from acquire.daemon.commands.control import Control
from acquire.daemon.commands.device_commands import DeviceCommands
from acquire.daemon.commands.scan_commands import ScanCommands
from acquire.daemon.commands.service_commands import ServiceCommands
from acquire.daemon.commands.table import CommandDispatcher, command_table
from acquire.rigs.base import DeviceEvent, Rig
from acquire.rigs.build import build_rig
from acquire.rigs.status_board import StatusBoard

from .clock_watch import ClockWatch
from .event_queue import EventQueue
from .frame_sender import FrameSender
from .lamp_timer import LampTimer
from .resume import unfinished_scan
from .scan_supervisor import ScanSupervisor

logger = logging.getLogger(__name__)
POLL_MS = 10
EARLY_STATUS_NS = NS_PER_S // 25
"""After a change the status is published at once, but not more often than this."""
LEAST_NOISE_BLOCKS = 10
"""Damaged blocks on the stage's serial line that are reported; a few come with plugging in."""


class Daemon:
    """The loop, and the parts that it hands events to."""

    def __init__(self, config: LoadedConfig, run_dir: Path, rig: Rig, clock: Clock | None = None) -> None:
        self.config, self.rig = config, rig
        self.clock = clock or MonotonicClock()
        self.board = StatusBoard(self.clock)
        self._run_dir = run_dir
        self._context: zmq.Context[Any] = zmq.Context()
        self._events: EventQueue[DeviceEvent] = EventQueue()
        self._frames = FrameSender(bind(self._context, zmq.ROUTER, run_dir, "frames"))
        live = Sender(bind(self._context, zmq.PUB, run_dir, "live"))
        self._status = Sender(bind(self._context, zmq.PUB, run_dir, "status"))
        self.preview = PreviewPublisher(bind(self._context, zmq.XPUB, run_dir, "preview"))
        self.runner = ActivityRunner(rig, config.rig, self.board, self.preview)
        self.scans = ScanSupervisor(rig, config.rig.limits, self._frames, live, self.board, self.runner, self.preview)
        self._control = Control()
        self._lamp = LampTimer(config.rig.lamp.warm_up_s * config.rig.time_scale)
        self.commands = self._dispatcher()
        self._notifier = Notifier()
        self._clock_watch = ClockWatch()
        self._unreadable, self._noisy = Threshold(1), Threshold(LEAST_NOISE_BLOCKS)
        self._status_due_ns = self._early_status_ns = 0
        self._ending = False

    def _dispatcher(self) -> CommandDispatcher:
        rig, config, status = self.rig, self.config, self.current_status
        table = command_table(
            ScanCommands(rig, config, self.scans, self.runner),
            DeviceCommands(rig, config.rig.stage, self.runner),
            ActivityCommands(rig, config, self.runner, self._lamp, status),
            ServiceCommands(self._control, self.board, status, self.request_end),
        )
        return CommandDispatcher(table, self._control, status)

    # ---- life ----

    def open(self) -> None:
        """Connect the devices."""
        camera = self.config.rig.camera
        self.rig.open(self._events.put, CameraSettings(camera.exposure_ms, camera.gain, camera.brightness_percent))
        # bound last: a client that finds the command lane finds a rig that answers at once
        socket = bind(self._context, zmq.ROUTER, self._run_dir, "command")
        self._server = CommandServer(socket, self.clock, self.config.rig.limits.command_s, self.commands.serve)
        self.board.enter(State.IDLE)
        self.board.say(f"ready: {self.rig.stage_info.kind} stage, {self.rig.camera_info.kind} camera")
        interrupted = unfinished_scan(self.config.data_dir)
        if interrupted is not None:
            self.scans.note_unfinished(interrupted)

    def request_end(self) -> None:
        """End after this turn of the loop; a signal handler may call it."""
        self._ending = True

    def run(self) -> None:
        """Serve until told to end, then bring the running scan to its end within the stop time-out."""
        poller = zmq.Poller()
        for source in (self._frames.socket, self._server.socket, self._events.fileno()):
            poller.register(source, zmq.POLLIN)
        deadline_ns: int | None = None
        self._notifier.ready(self.board.message)
        while True:
            poller.poll(POLL_MS)
            self.turn()
            self._notifier.alive()
            if not self._ending:
                continue
            now_ns = self.clock.now_ns()
            if deadline_ns is None:
                deadline_ns = now_ns + round(self.config.rig.limits.stop_s * NS_PER_S)
                self._notifier.stopping()
                self.scans.interrupt(now_ns)
            if self.scans.running is None or now_ns > deadline_ns:
                break

    def close(self) -> None:
        """Bring everything to rest; each step is tried even if the one before failed."""
        to_rest: tuple[Callable[[], object], ...] = (self.rig.stage.stop, self.rig.camera.disarm, self.scans.close)
        steps: tuple[Callable[[], object], ...] = (
            *(to_rest if self.rig.is_open else ()),
            self.rig.stage.close,
            self.rig.camera.close,
            *((self._publish_last,) if self.rig.is_open else ()),
            lambda: self._context.destroy(linger=200),
            self._events.close,
        )
        for step in steps:
            try:
                step()
            except Exception:  # noqa: BLE001 - the outermost end: one failing step must not keep the next from running
                logger.exception("a step of the cleanup failed")

    # ---- one turn of the loop ----

    def turn(self) -> None:
        """Handle everything that has come."""
        now_ns = self.clock.now_ns()
        self._watch_clocks(now_ns)
        events, answers = self._events.take_all(), self._frames.poll(now_ns)
        for event in events:
            self.take(event, now_ns)
        for answer in answers:
            if self.scans.running is not None:
                self.scans.running.handle(answer, now_ns)
        if self._server.serve() or events or answers:
            self.board.touch()
        self._watch_messages()
        if self.scans.running is None:
            self.runner.tick(now_ns)
        elif self.scans.tick(now_ns):
            # the outcome is published while the scan still runs, then the rig becomes idle
            self._publish_status(self.clock.now_ns(), force=True)
            self.scans.finish(self.clock.now_ns())
        self.rig.stage.keep_alive()
        self._publish_status(now_ns)
        # pictures come last: everything that the stage waits for has been sent
        self.preview.poll()
        self.preview.flush(now_ns, self.rig.camera_info.format, self.runner.rate_hz)

    def take(self, event: DeviceEvent, now_ns: int) -> None:
        """Hand an event of a device to the running scan, or to the activities."""
        if isinstance(event, CameraGone):
            self.scans.note_camera(event)
        if self.scans.running is None:
            self.runner.take(event, now_ns)
        elif not self.runner.owed_until_ns or not self.runner.is_stale(event, now_ns):
            self.scans.running.handle(event, now_ns)

    def _watch_clocks(self, now_ns: int) -> None:
        """Note a frozen process and a jump of the wall clock: they do no harm, but explain a gap in a log."""
        for code, seconds in self._clock_watch.update(now_ns, epoch_utc_ns()):
            # shown to the operator only where it may have touched a scan
            if self.scans.running is not None:
                self.board.fault(report(code, seconds=f"{seconds:.0f}", **self.scans.progress))
            else:
                logger.info("%s: %.1f s", code, seconds)

    def _watch_messages(self) -> None:
        """Report messages and blocks that could not be read: the first, and when there are ten times as many."""
        count = self._server.malformed + self._frames.counters["malformed"]
        if self._unreadable.reached(count):
            self.board.fault(report("F20", count=count))
        damaged = self.rig.stage.status().damaged_blocks
        if self._noisy.reached(damaged):
            self.board.fault(report("F11", detail=f"{damaged} blocks came damaged"))

    # ---- status ----

    def _publish_status(self, now_ns: int, *, force: bool = False) -> None:
        early = now_ns >= self._early_status_ns and self.board.changed
        if not (force or early or now_ns >= self._status_due_ns):
            return
        self.board.published()
        self._status_due_ns = now_ns + round(NS_PER_S / self.config.rig.limits.status_hz)
        self._early_status_ns = now_ns + EARLY_STATUS_NS
        self._status.send(self.current_status(now_ns))

    def current_status(self, now_ns: int) -> Status:
        """The rig as it is now."""
        rig, stage, config = self.rig, self.rig.stage.status(), self.config.rig
        return Status(
            state=self.scans.state,
            position_steps=stage.position_steps,
            position_um=steps_to_um(stage.position_steps, config.stage.um_per_microstep),
            position_trusted=stage.position_trusted,
            zero_id=stage.zero_id,
            travel_steps=(config.stage.travel_min_steps, config.stage.travel_max_steps),
            stage_kind=rig.stage_info.kind,
            stage_version=rig.stage_info.version[:128],
            camera_kind=rig.camera_info.kind,
            camera=msgspec.structs.asdict(rig.camera_settings),
            camera_limits=rig.camera_info.limits,
            format=rig.camera_info.format,
            lamp_on=stage.lamp_on,
            lamp_warm_s=self._lamp.update(now_ns, on=stage.lamp_on),
            writer_alive=self._frames.alive(now_ns, round(config.limits.writer_lost_s * NS_PER_S)),
            counters=self._frames.counters | self.preview.counters | self.runner.counters | self.scans.counters,
            faults=self.board.faults,
            message=self.board.message,
            control=self._control.holder(now_ns),
            **msgspec.structs.asdict(self.runner.status()),
            **msgspec.structs.asdict(self.scans.status(now_ns)),
        )

    def _publish_last(self) -> None:
        self.board.close()
        self._publish_status(self.clock.now_ns(), force=True)


def run_daemon(config: LoadedConfig, run_dir: Path) -> None:
    """The daemon service: locks, binds, opens the rig, serves until SIGTERM or SIGINT.

    Raises:
        AlreadyRunningError: another daemon holds the lock.
        ConfigError: a socket or a driver that cannot be used.
    """
    lock = lock_service(prepare_run_dir(run_dir), "daemon")
    daemon = Daemon(config, run_dir, build_rig(config.rig))
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda _signal, _frame: daemon.request_end())
    try:
        daemon.open()
        daemon.run()
    finally:
        daemon.close()
        lock.release()
