"""The stage behind our firmware: turns calls into commands, and never guesses a position."""

from __future__ import annotations

import logging
import time
from concurrent.futures import Future

from acquire.contract.errors import CommandRefusedError, ConfigError
from acquire.stages.protocol import Moved, Segment, StageInfo, StageSink
from acquire.stages.uno.framing import Block

from .config import segment_body
from .reports import Activity, UnoReports, result_of
from .serial_io import LinkLostError
from .texts import refusal
from .wire_format import (
    RATE_MAX,
    RATE_MIN,
    RT_ESTOP,
    RT_ESTOP_CONFIRM,
    RT_HOLD,
    RT_STOP,
    RT_STOP_CONFIRM,
    Cmd,
    DiagnosisBody,
    GrantBody,
    LampBody,
    McuHold,
    McuState,
    MoveBody,
    Result,
    StatusBody,
    ZeroBody,
)

logger = logging.getLogger(__name__)

_REST_S = 5.0


class UnoStage(UnoReports):
    """Stage on an Arduino Uno with our firmware, real or emulated.

    Calls wait for the firmware's acknowledgement (milliseconds), never for motion; do not call from the sink.
    ``keep_alive`` must be called while something moves: without it the link falls silent and the firmware holds.
    """

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
            has_limit_switch=self._has_switch,
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

    def move_to(self, position_steps: int, rate_steps_per_s: float = 0.0) -> None:
        """Start a move."""
        low, high = self._config.travel_min_steps, self._config.travel_max_steps
        if self.status().position_trusted and not low <= position_steps <= high:
            raise CommandRefusedError(f"{position_steps} microsteps is outside the travel {low}..{high}")
        rate = min(rate_steps_per_s, self._config.max_rate_steps_per_s, RATE_MAX)
        self._start("move", Cmd.MOVE, MoveBody(position_steps, 0, max(RATE_MIN, round(rate)) if rate else 0).pack())

    def home(self) -> None:
        """Find the limit switch; makes a new zero."""
        if not self._has_switch:
            raise CommandRefusedError("stage.limit_switch = 'none': jog to the near end of the travel, then zero")
        self._start("home", Cmd.HOME)

    def zero_here(self) -> None:
        """Call the present place zero."""
        self._start("zero", Cmd.ZERO, ZeroBody(0).pack())

    def check_limit(self) -> None:
        """Touch the limit switch again; without one the report follows at once, and says nothing of lost steps."""
        if self._has_switch:
            self._start("touch", Cmd.TOUCH)
            return
        status = self.status()
        self._sink(Moved(status.position_steps, status.position_trusted, status.zero_id, steps_lost=None))

    @property
    def _has_switch(self) -> bool:
        return self._config.limit_switch != "none"

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
        if result_of(self._link.ask(Cmd.LAMP, LampBody(int(on)).pack())) == Result.ALARM:
            raise CommandRefusedError("the lamp stays off: an alarm stands; release its cause, then home the stage")

    # ---- besides the protocol ----

    def diagnose(self) -> DiagnosisBody:
        """The firmware's own counters."""
        return DiagnosisBody.unpack(self._link.ask(Cmd.DIAGNOSE).body)

    # ---- starting something ----

    def _configure(self) -> None:
        """A sweep that outlived its host is stopped first: its credit and its frames belonged to another process."""
        deadline_s = time.monotonic() + _REST_S
        while (result := result_of(self._link.ask(Cmd.CONFIGURE, self._body.pack()))) != Result.OK:
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
            result = result_of(self._link.ask(Cmd.CLEAR))
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
            result = result_of(answer.result(timeout=3.0))
        except TimeoutError as error:
            raise LinkLostError(f"the stage's controller did not answer {kind.name}") from error
        if result != Result.OK:
            raise refusal(result, kind, self._config)

    def _on_started(self, activity: Activity, done: Future[Block]) -> None:
        if done.exception() is None and result_of(done.result()) == Result.OK:
            with self._lock:
                self._activity = activity
                self._polled_s = 0.0
