"""The stage behind our firmware: turns calls into commands, reports into events, and never guesses a position."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Literal

import serial

from acquire.contract.config_model import StageConfig
from acquire.contract.errors import CommandRefusedError, ConfigError
from acquire.framing import Block

from .link import Link, LinkLostError, LinkTiming
from .ports import choose_port, open_port
from .protocol import Alarm, Held, Moved, Segment, SegmentDone, StageInfo, StageSink, StageStatus, Stopped, Triggered
from .uno_config import config_body, segment_body
from .uno_words import alarm_event, refusal, reset_words
from .wire import (
    LINK_BAUD,
    RT_ESTOP,
    RT_ESTOP_CONFIRM,
    RT_HOLD,
    RT_STOP,
    RT_STOP_CONFIRM,
    AckBody,
    Cmd,
    DiagnosisBody,
    EventBody,
    Flag,
    GrantBody,
    HelloReplyBody,
    LampBody,
    McuAlarm,
    McuHold,
    McuState,
    McuStop,
    MoveBody,
    Msg,
    ReportBody,
    Result,
    StatusBody,
    ZeroBody,
)

logger = logging.getLogger(__name__)

_POLL_ACTIVE_S = 0.02
_POLL_IDLE_S = 0.2
_RESUME_AGAIN_S = 0.1
_REST_S = 5.0
_RECONNECT_S = 15.0
"""So long the controller may be away before the activity is given up."""

Activity = Literal["move", "home", "zero", "touch", "segment"]


class UnoStage:
    """Stage on an Arduino Uno with our firmware, real or emulated.

    Calls wait for the firmware's acknowledgement (milliseconds), never for motion; do not call from the sink.
    ``keep_alive`` must be called while something moves: without it the link falls silent and the firmware holds.
    """

    def __init__(
        self,
        config: StageConfig,
        *,
        opener: Callable[[], serial.Serial] | None = None,
        timing: LinkTiming | None = None,
    ) -> None:
        self._config = config
        self._body = config_body(config)
        self._link = Link(
            opener or (lambda: open_port(choose_port(config.port), LINK_BAUD)), self, timing or LinkTiming()
        )
        self._sink: StageSink = lambda _event: None
        self._lock = threading.RLock()
        self._report: ReportBody | None = None
        self._activity: Activity | None = None
        self._claimed = False
        self._segment_id = 0
        self._segment = Segment(0, 1, 1)
        self._first_id = 0
        self._granted = -1
        self._next_event = 0
        self._hold_wanted = False
        self._held_for = McuHold.NONE
        self._lost_since_s: float | None = None
        self._alive_s = self._polled_s = self._resumed_s = 0.0
        self.strobes = 0
        """Strobes that the firmware has seen since its start."""

    # ---- protocol ----

    def open(self, sink: StageSink) -> StageInfo:
        """Connect, check the firmware, hand it the configuration.

        Raises:
            SweepscopeError: no port, no answer, another firmware or version; one line says what to do.
        """
        self._sink = sink
        self._alive_s = time.monotonic()
        hello = self._link.open()
        try:
            self._configure()
            self._link.ask(Cmd.STATUS, StatusBody(0).pack())
        except BaseException:
            self._link.close()
            raise
        with self._lock:
            self._next_event = self._need_report().triggers  # what was fired before is not ours
        return StageInfo(
            kind="uno",
            version=f"{hello.firmware_version // 100}.{hello.firmware_version % 100:02d}",
            boot_id=f"{hello.boot_id:08x}",
            counts_triggers=True,
            counts_strobes=True,
            has_limit_switch=True,
            modes=("step", "fly"),
        )

    def close(self) -> None:
        """Stop motion, switch the lamp off, disconnect; idempotent, never raises."""
        if self._link.connected:
            self._link.realtime(bytes((RT_STOP, RT_STOP_CONFIRM)))
            self._link.send(Cmd.STOP)
            try:
                self._link.ask(Cmd.LAMP, LampBody(0).pack(), timeout_s=0.5)
            except LinkLostError as error:
                logger.warning("the stage was closed without an answer: %s", error)
        self._link.close()

    def status(self) -> StageStatus:
        """What the last report said."""
        with self._lock:
            report = self._report
            lost = self._lost_since_s is not None
            moving = self._activity is not None or self._claimed
        if report is None:
            return StageStatus(0, position_trusted=False, zero_id="", moving=False, triggers=0)
        return StageStatus(
            position_steps=report.position,
            position_trusted=bool(report.flags & Flag.TRUSTED) and not lost,
            zero_id=_zero_id(report),
            moving=moving,
            triggers=report.triggers,
            lamp_on=bool(report.flags & Flag.LAMP),
        )

    def move_to(self, position_steps: int) -> None:
        """Start a move."""
        low, high = self._config.travel_min_steps, self._config.travel_max_steps
        if self.status().position_trusted and not low <= position_steps <= high:
            raise CommandRefusedError(f"{position_steps} microsteps is outside the travel {low}..{high}")
        self._start("move", Cmd.MOVE, MoveBody(position_steps, 0, 0).pack())

    def home(self) -> None:
        """Find the limit switch; makes a new zero."""
        self._start("home", Cmd.HOME)

    def zero_here(self) -> None:
        """Call the present place zero."""
        self._start("zero", Cmd.ZERO, ZeroBody(0).pack())

    def check_limit(self) -> None:
        """Touch the limit switch again."""
        self._start("touch", Cmd.TOUCH)

    def begin_segment(self, segment: Segment, may_trigger_through: int) -> int:
        """Start a segment; the firmware runs it by itself as far as it is granted."""
        self._claim()
        try:
            with self._lock:
                first_id = self._need_report().triggers
                self._segment_id = (self._segment_id + 1) & 0xFFFF
                self._segment, self._first_id = segment, first_id
                self._granted = may_trigger_through
                body = segment_body(segment, self._segment_id, first_id)
            if may_trigger_through >= 0:
                self._link.send(Cmd.GRANT, GrantBody(first_id + may_trigger_through).pack())
            self._run("segment", Cmd.SEGMENT, body.pack())
        finally:
            self._claimed = False
        return first_id

    def grant(self, may_trigger_through: int) -> None:
        """Raise the absolute credit of the running segment."""
        with self._lock:
            self._granted = max(self._granted, may_trigger_through)
            through = self._first_id + self._granted
        self._link.send(Cmd.GRANT, GrantBody(through).pack())

    def hold(self) -> None:
        """Hold: by a realtime byte, and by a command in case noise ate it."""
        with self._lock:
            if self._activity != "segment":
                return
            self._hold_wanted = True
        self._link.realtime(bytes((RT_HOLD,)))
        self._link.send(Cmd.HOLD)

    def resume(self) -> None:
        """Go on after a hold."""
        with self._lock:
            self._hold_wanted = False
        self._link.send(Cmd.RESUME)

    def stop(self) -> None:
        """Decelerate and end."""
        if self._activity is not None or self._claimed:
            self._link.realtime(bytes((RT_STOP, RT_STOP_CONFIRM)))
        self._link.send(Cmd.STOP)

    def emergency_stop(self) -> None:
        """No step after this, driver and lamp off; the position is lost."""
        self._link.realtime(bytes((RT_ESTOP, RT_ESTOP_CONFIRM)))

    def set_lamp(self, *, on: bool) -> None:
        """Switch the lamp; back when the firmware has done it, so that the next picture is taken by its light."""
        if _result(self._link.ask(Cmd.LAMP, LampBody(int(on)).pack())) == Result.ALARM:
            raise CommandRefusedError("the lamp stays off: an alarm stands; release its cause, then home the stage")

    def keep_alive(self) -> None:
        """The host's main loop lives; also gives the activity up when the controller stays away."""
        self._alive_s = time.monotonic()
        lost_s = self._lost_since_s
        if lost_s is not None and self._alive_s - lost_s > _RECONNECT_S:
            self._give_up("F12", "it did not come back")

    # ---- besides the protocol ----

    def diagnose(self) -> DiagnosisBody:
        """The firmware's own counters."""
        return DiagnosisBody.unpack(self._link.ask(Cmd.DIAGNOSE).body)

    def counters(self) -> dict[str, int]:
        """The link's counters."""
        return {**self._link.counters(), "strobes": self.strobes}

    @property
    def report(self) -> ReportBody:
        """The firmware's last report."""
        return self._need_report()

    # ---- starting something ----

    def _need_report(self) -> ReportBody:
        if self._report is None:
            raise LinkLostError("the stage's controller has not reported yet")
        return self._report

    def _configure(self) -> None:
        """A sweep that outlived its host is stopped first: its credit and its frames belonged to another process."""
        deadline_s = time.monotonic() + _REST_S
        while (result := _result(self._link.ask(Cmd.CONFIGURE, self._body.pack()))) != Result.OK:
            if result == Result.RANGE:
                raise ConfigError("the firmware refuses [stage]: a rate, acceleration or travel is out of its bounds")
            if time.monotonic() > deadline_s:
                raise LinkLostError(f"the stage does not come to rest in {_REST_S:.0f} s: look at it, then try again")
            self._link.ask(Cmd.STOP)

    def _claim(self) -> None:
        with self._lock:
            if self._activity is not None or self._claimed:
                raise CommandRefusedError("the stage is moving: wait for it, or stop it")
            if self._lost_since_s is not None:
                raise CommandRefusedError("the stage's controller is not connected: plug it in")
            alarm = self._need_report().state == McuState.ALARM
            self._claimed = True
            self._hold_wanted = False
            self._held_for = McuHold.NONE
        if alarm:
            self._clear_alarm()

    def _clear_alarm(self) -> None:
        try:
            result = _result(self._link.ask(Cmd.CLEAR))
            self._link.ask(Cmd.STATUS, StatusBody(self._next_event).pack())
        except BaseException:
            self._claimed = False
            raise
        if result != Result.OK:
            self._claimed = False
            raise CommandRefusedError("the emergency stop is pressed: release it, then home the stage")

    def _start(self, activity: Activity, kind: Cmd, body: bytes = b"") -> None:
        self._claim()
        try:
            self._run(activity, kind, body)
        finally:
            self._claimed = False

    def _run(self, activity: Activity, kind: Cmd, body: bytes) -> None:
        """The activity begins in the link's thread with the acknowledgement: every later report speaks of it."""
        self._alive_s = time.monotonic()
        answer = self._link.send(kind, body)
        answer.add_done_callback(lambda done: self._on_started(activity, done))
        try:
            result = _result(answer.result(timeout=3.0))
        except TimeoutError as error:
            raise LinkLostError(f"the stage's controller did not answer {kind.name}") from error
        if result != Result.OK:
            raise refusal(result, kind, self._config)

    def _on_started(self, activity: Activity, done: Future[Block]) -> None:
        if done.exception() is None and _result(done.result()) == Result.OK:
            with self._lock:
                self._activity = activity
                self._polled_s = 0.0

    # ---- from the link's thread ----

    def poll(self) -> bytes | None:
        """Ask for the state: often while something moves, and only while the host's main loop lives."""
        now_s = time.monotonic()
        with self._lock:
            report, active = self._report, self._activity is not None
            behind = report is not None and report.triggers > self._next_event
            seen = self._next_event
        every_s = 0.0 if behind else _POLL_ACTIVE_S if active else _POLL_IDLE_S
        if now_s - self._polled_s < every_s or (active and not self._host_lives(now_s)):
            return None
        self._polled_s = now_s
        return StatusBody(seen).pack()

    def _host_lives(self, now_s: float) -> bool:
        return now_s - self._alive_s < self._config.motion_lease_ms / 2000

    def on_report(self, report: ReportBody, events: tuple[EventBody, ...]) -> None:
        """Pass trigger events on in order, then what became of the activity."""
        with self._lock:
            self._report = report
            self.strobes = report.strobes
            fired = self._take_events(events)
        for event in fired:
            self._sink(event)
        if self._activity is None:
            return
        if report.state in (McuState.IDLE, McuState.ALARM):
            if report.triggers <= self._next_event:
                self._finish(report)
        else:
            self._watch_hold(report)

    def _take_events(self, events: tuple[EventBody, ...]) -> list[Triggered]:
        fired = []
        at_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
        for event in events:
            if event.trigger_id == self._next_event:
                self._next_event += 1
                shot = event.trigger_id - self._first_id
                middle_um = self._middle_um(event.position)
                fired.append(Triggered(event.trigger_id, shot, event.position, event.cycles, at_ns, middle_um))
        return fired

    def _middle_um(self, position_steps: int) -> float | None:
        """Where the stage is half an exposure after a trigger on the fly; None where it stands still."""
        segment = self._segment
        if segment.mode != "fly" or not segment.period_ms:
            return None
        half_way_steps = segment.pitch_steps * segment.dwell_ms / 2 / segment.period_ms
        return (position_steps + half_way_steps) * self._config.um_per_microstep

    def _watch_hold(self, report: ReportBody) -> None:
        reason = McuHold(report.hold_reason) if report.state == McuState.HOLDING else McuHold.NONE
        if reason in (McuHold.HOST, McuHold.REALTIME) and not self._hold_wanted:
            self._resume_soon()  # noise looked like the realtime byte
        elif reason == McuHold.LEASE and not self._hold_wanted and self._host_lives(time.monotonic()):
            self._resume_soon()
        if reason != self._held_for:
            self._held_for = reason
            self._tell_held(reason, report.position)

    def _tell_held(self, reason: McuHold, position_steps: int) -> None:
        if reason in (McuHold.HOST, McuHold.REALTIME) and self._hold_wanted:
            self._sink(Held("requested", position_steps))
        elif reason == McuHold.LEASE:
            self._sink(Held("lease", position_steps))
        elif reason == McuHold.NO_CREDIT and self._segment.mode == "fly":
            self._sink(Held("no credit", position_steps))

    def _resume_soon(self) -> None:
        now_s = time.monotonic()
        if now_s - self._resumed_s > _RESUME_AGAIN_S:
            self._resumed_s = now_s
            self._link.send(Cmd.RESUME)

    def _finish(self, report: ReportBody) -> None:
        with self._lock:
            activity, self._activity = self._activity, None
        if report.state == McuState.ALARM:
            self._sink(alarm_event(McuAlarm(report.alarm), report.position))
        elif report.stop_reason != McuStop.DONE and activity != "zero":
            reason = "lease" if report.stop_reason == McuStop.LEASE else "requested"
            self._sink(Stopped(report.position, position_trusted=bool(report.flags & Flag.TRUSTED), reason=reason))
        elif activity == "segment":
            self._sink(SegmentDone(report.position))
        else:
            lost = report.steps_lost if activity == "touch" and report.flags & Flag.TOUCHED else None
            trusted = bool(report.flags & Flag.TRUSTED)
            self._sink(Moved(report.position, trusted, zero_id=_zero_id(report), steps_lost=lost))

    def on_lost(self, detail: str) -> None:
        """The firmware holds by its lease; wait for it to come back."""
        logger.warning("the stage's controller is gone: %s", detail)
        self._lost_since_s = time.monotonic()

    def on_back(self, hello: HelloReplyBody, *, same_session: bool) -> None:
        """The same one: go on. Restarted: it knows nothing any more, not even where it is."""
        with self._lock:
            self._lost_since_s = None
            through = self._first_id + self._granted
            running = self._activity == "segment" and self._granted >= 0
        if same_session:
            if running:
                self._link.send(Cmd.GRANT, GrantBody(through).pack())
            self._link.send(Cmd.STATUS, StatusBody(self._next_event).pack())
            return
        with self._lock:
            self._next_event = 0
        self._link.send(Cmd.CONFIGURE, self._body.pack())
        self._link.send(Cmd.STATUS, StatusBody(0).pack())
        self._give_up("F13", f"{reset_words(hello.reset_cause)}; home the stage, then resume")

    def _give_up(self, code: str, detail: str) -> None:
        with self._lock:
            activity, self._activity = self._activity, None
            position = self._report.position if self._report is not None else 0
        if activity is not None:
            self._sink(Alarm(code, detail, position, position_trusted=False))


def _result(answer: Block) -> Result:
    return Result(AckBody.unpack(answer.body).result) if answer.kind == Msg.ACK else Result.OK


def _zero_id(report: ReportBody) -> str:
    return f"{report.zero_id:08x}" if report.zero_id else ""
