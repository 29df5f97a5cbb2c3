"""Follows the firmware by its reports: trigger events in order, holds, the end of each motion, a lost controller.

Runs in the thread of the serial link; :mod:`acquire.stages.uno.stage` makes the calls. What both need is kept here
behind one lock, and changes by the verbs of :class:`ReportFollower` only.
"""

from __future__ import annotations

import logging
import threading
import time
from concurrent.futures import Future
from typing import Literal, Protocol

from acquire.contract.config.model import StageConfig
from acquire.contract.errors import CommandRefusedError
from acquire.contract.process.clocks import mono_ns
from acquire.stages.protocol import Alarm, Held, Moved, Segment, SegmentDone, StageSink, StageStatus, Stopped, Triggered
from acquire.stages.uno.framing import Block

from .serial_io import LinkLostError
from .texts import alarm_event, reset_words
from .wire_format import (
    AckBody,
    Cmd,
    EventBody,
    Flag,
    GrantBody,
    HelloReplyBody,
    McuAlarm,
    McuHold,
    McuState,
    McuStop,
    Msg,
    ReportBody,
    Result,
    StatusBody,
)

logger = logging.getLogger(__name__)

_POLL_ACTIVE_S = 0.02
_POLL_IDLE_S = 0.2
_RESUME_AGAIN_S = 0.1
_RECONNECT_S = 15.0
"""The activity is given up when the controller has been away for this long."""
_NS_PER_16_CYCLES = 1000
"""At 16 MHz."""

Activity = Literal["move", "home", "zero", "touch", "segment"]


class Send(Protocol):
    """Queues a command on the link; the future holds its answer."""

    def __call__(self, kind: Cmd, body: bytes = b"") -> Future[Block]:
        """Queue it."""
        ...


class ReportFollower:
    """What the host knows of the controller, and the events that follow from its reports."""

    def __init__(self, config: StageConfig, configuration: bytes, send: Send) -> None:
        """``configuration`` is the body that is sent again to a controller that has restarted."""
        self.sink: StageSink = lambda _event: None
        self._config = config
        self._configuration = configuration
        self._send = send
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
        self._alive_s = time.monotonic()
        self._polled_s = self._resumed_s = 0.0
        self._asked_ns = self._no_alarm_ns = 0
        self.strobes = 0
        """Strobes that the firmware has counted since its start."""

    # ---- what the calls change ----

    def ignore_past_triggers(self) -> None:
        """Triggers fired before this connection belong to another process."""
        with self._lock:
            self._next_event = self.report.triggers

    def claim(self) -> bool:
        """Reserve the stage for one activity; True if an alarm must be cleared first.

        Raises:
            CommandRefusedError: it moves already, or its controller is not connected.
        """
        with self._lock:
            if self._activity is not None or self._claimed:
                raise CommandRefusedError("the stage is moving: wait for it, or stop it")
            if self._lost_since_s is not None:
                raise CommandRefusedError("the stage's controller is not connected: plug it in")
            alarm = self.report.state == McuState.ALARM
            self._claimed = True
            self._hold_wanted = False
            self._held_for = McuHold.NONE
            return alarm

    def release(self) -> None:
        """End the reservation; an activity that was started goes on."""
        self._claimed = False

    def started(self, activity: Activity) -> None:
        """The firmware has acknowledged the start: every later report is about this activity."""
        with self._lock:
            self._activity = activity
            self._polled_s = 0.0

    def prepare_segment(self, segment: Segment, may_trigger_through: int) -> tuple[int, int]:
        """Remember the segment that is about to start; returns its id and the trigger id of shot 0."""
        with self._lock:
            self._segment_id = (self._segment_id + 1) & 0xFFFF
            self._segment, self._first_id = segment, self.report.triggers
            self._granted = may_trigger_through
            return self._segment_id, self._first_id

    def raise_credit(self, may_trigger_through: int) -> int:
        """Raise the segment's credit; returns it as a trigger id."""
        with self._lock:
            self._granted = max(self._granted, may_trigger_through)
            return self._first_id + self._granted

    def want_hold(self, *, hold: bool) -> bool:
        """Remember whether a hold is wanted; False if there is no segment to hold."""
        with self._lock:
            if hold and self._activity != "segment":
                return False
            self._hold_wanted = hold
            return True

    @property
    def active(self) -> bool:
        """True while something moves or is about to."""
        return self._activity is not None or self._claimed

    @property
    def next_event(self) -> int:
        """Id of the next trigger event that the host expects."""
        return self._next_event

    @property
    def report(self) -> ReportBody:
        """The firmware's last report.

        Raises:
            LinkLostError: there is none yet.
        """
        if self._report is None:
            raise LinkLostError("the stage's controller has not reported yet")
        return self._report

    def status(self) -> StageStatus:
        """What the last report said."""
        with self._lock:
            report = self._report
            lost = self._lost_since_s is not None
            moving = self.active
        if report is None:
            return StageStatus(0, position_trusted=False, zero_id="", moving=False, triggers=0)
        return StageStatus(
            position_steps=report.position,
            position_trusted=bool(report.flags & Flag.TRUSTED) and not lost,
            zero_id=_zero_id(report),
            moving=moving,
            triggers=report.triggers,
            lamp_on=bool(report.flags & Flag.LAMP),
            no_alarm_ns=self._no_alarm_ns,
        )

    def keep_alive(self) -> None:
        """The host's main loop is running; gives the activity up when the controller stays away."""
        self._alive_s = time.monotonic()
        lost_s = self._lost_since_s
        if lost_s is not None and self._alive_s - lost_s > _RECONNECT_S:
            self._give_up("F12", "it did not come back")

    # ---- from the link's thread ----

    def poll(self) -> bytes | None:
        """Body of the next status request: often during motion, and then only while the host's main loop is running."""
        now_s = time.monotonic()
        with self._lock:
            report, active = self._report, self._activity is not None
            behind = report is not None and report.triggers > self._next_event
            seen = self._next_event
        every_s = 0.0 if behind else _POLL_ACTIVE_S if active else _POLL_IDLE_S
        if now_s - self._polled_s < every_s or (active and not self._host_is_running(now_s)):
            return None
        self._polled_s = now_s
        self._asked_ns = mono_ns()
        return StatusBody(seen).pack()

    def _host_is_running(self, now_s: float) -> bool:
        return now_s - self._alive_s < self._config.motion_lease_ms / 2000

    def on_report(self, report: ReportBody, events: tuple[EventBody, ...]) -> None:
        """Pass on trigger events in order, then the end or hold of the activity."""
        with self._lock:
            self._report = report
            self.strobes = report.strobes
            fired = self._take_events(events)
        for event in fired:
            self.sink(event)
        if report.state != McuState.ALARM:
            # the report was made after it was requested, so there was no alarm at that time
            self._no_alarm_ns = self._asked_ns
        if self._activity is None:
            return
        if report.state in (McuState.IDLE, McuState.ALARM):
            if report.triggers <= self._next_event:
                self._finish(report)
        else:
            self._watch_hold(report)

    def _take_events(self, events: tuple[EventBody, ...]) -> list[Triggered]:
        fired = []
        at_ns = mono_ns()
        for event in events:
            if event.trigger_id == self._next_event:
                self._next_event += 1
                shot = event.trigger_id - self._first_id
                middle_um = self._middle_um(event.position)
                fired_ns = event.cycles * _NS_PER_16_CYCLES // 16
                fired.append(
                    Triggered(event.trigger_id, shot, event.position, event.cycles, at_ns, middle_um, fired_ns)
                )
        return fired

    def _middle_um(self, position_steps: int) -> float | None:
        """Position half an exposure after a trigger in fly mode; None in step mode."""
        segment = self._segment
        if segment.mode != "fly" or not segment.period_ms:
            return None
        half_way_steps = segment.pitch_steps * segment.dwell_ms / 2 / segment.period_ms
        return (position_steps + half_way_steps) * self._config.um_per_microstep

    def _watch_hold(self, report: ReportBody) -> None:
        reason = McuHold(report.hold_reason) if report.state == McuState.HOLDING else McuHold.NONE
        if reason in (McuHold.HOST, McuHold.REALTIME) and not self._hold_wanted:
            self._resume_soon()  # noise was taken for the realtime byte
        elif reason == McuHold.LEASE and not self._hold_wanted and self._host_is_running(time.monotonic()):
            self._resume_soon()
        if reason != self._held_for:
            self._held_for = reason
            self._tell_held(reason, report.position)

    def _tell_held(self, reason: McuHold, position_steps: int) -> None:
        if reason in (McuHold.HOST, McuHold.REALTIME) and self._hold_wanted:
            self.sink(Held("requested", position_steps))
        elif reason == McuHold.LEASE:
            self.sink(Held("lease", position_steps))
        elif reason == McuHold.NO_CREDIT and self._segment.mode == "fly":
            self.sink(Held("no credit", position_steps))

    def _resume_soon(self) -> None:
        now_s = time.monotonic()
        if now_s - self._resumed_s > _RESUME_AGAIN_S:
            self._resumed_s = now_s
            self._send(Cmd.RESUME)

    def _finish(self, report: ReportBody) -> None:
        with self._lock:
            activity, self._activity = self._activity, None
        if report.state == McuState.ALARM:
            self.sink(alarm_event(McuAlarm(report.alarm), report.position))
        elif report.stop_reason != McuStop.DONE and activity != "zero":
            reason = "lease" if report.stop_reason == McuStop.LEASE else "requested"
            self.sink(Stopped(report.position, position_trusted=bool(report.flags & Flag.TRUSTED), reason=reason))
        elif activity == "segment":
            self.sink(SegmentDone(report.position))
        else:
            lost = report.steps_lost if activity == "touch" and report.flags & Flag.TOUCHED else None
            trusted = bool(report.flags & Flag.TRUSTED)
            self.sink(Moved(report.position, trusted, zero_id=_zero_id(report), steps_lost=lost))

    def on_lost(self, detail: str) -> None:
        """The link is lost; the firmware holds by its lease until it is back."""
        logger.warning("the stage's controller is gone: %s", detail)
        with self._lock:
            self._lost_since_s = time.monotonic()
            segment = self._activity == "segment"
            position = self._report.position if self._report is not None else 0
        if segment:
            self.sink(Held("link lost", position))

    def on_back(self, hello: HelloReplyBody, *, same_session: bool) -> None:
        """Same session: continue. Restarted: configure it again and end the activity; its position is lost."""
        with self._lock:
            self._lost_since_s = None
            through = self._first_id + self._granted
            running = self._activity == "segment" and self._granted >= 0
        if same_session:
            if running:
                self._send(Cmd.GRANT, GrantBody(through).pack())
            self._send(Cmd.STATUS, StatusBody(self._next_event).pack())
            return
        with self._lock:
            self._next_event = 0
        self._send(Cmd.CONFIGURE, self._configuration)
        self._send(Cmd.STATUS, StatusBody(0).pack())
        self._give_up("F13", f"{reset_words(hello.reset_cause)}; home the stage, then resume")

    def _give_up(self, code: str, detail: str) -> None:
        with self._lock:
            activity, self._activity = self._activity, None
            position = self._report.position if self._report is not None else 0
        if activity is not None:
            self.sink(Alarm(code, detail, position, position_trusted=False))


def result_of(answer: Block) -> Result:
    """Result code of a command; a request that was answered by a message of its own is OK."""
    return Result(AckBody.unpack(answer.body).result) if answer.kind == Msg.ACK else Result.OK


def _zero_id(report: ReportBody) -> str:
    return f"{report.zero_id:08x}" if report.zero_id else ""
