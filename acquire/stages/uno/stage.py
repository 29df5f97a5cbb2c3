"""The stage behind our firmware: calls become commands; positions are those that the firmware reports."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from concurrent.futures import Future

import msgspec
import serial

from acquire.contract.config.model import StageConfig
from acquire.contract.errors import CommandRefusedError, ConfigError
from acquire.stages.protocol import Moved, Segment, StageInfo, StageSink, StageStatus
from acquire.stages.uno.framing import Block

from .config import config_body, segment_body
from .handshake import FirmwareMismatchError
from .link import Link, LinkTiming
from .ports import choose_port, open_port
from .reports import Activity, ReportFollower, result_of
from .serial_io import LinkLostError
from .texts import refusal
from .wire_format import (
    LINK_BAUD,
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
    HelloReplyBody,
    LampBody,
    MoveBody,
    ReportBody,
    Result,
    StatusBody,
    ZeroBody,
)

logger = logging.getLogger(__name__)

_REST_S = 5.0


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
        """``opener`` opens the port, also again after the link was lost; by default that of ``config.port``."""
        self._config = config
        self._body = config_body(config)
        self._follower = ReportFollower(config, self._body.pack(), self.send)
        self._link = Link(
            opener or (lambda: open_port(choose_port(config.port), LINK_BAUD)), self._follower, timing or LinkTiming()
        )

    # ---- protocol ----

    def open(self, sink: StageSink) -> StageInfo:
        """Connect, check the firmware, hand it the configuration.

        Raises:
            SweepscopeError: no port, no answer, another firmware or version; one line says what to do.
        """
        self._follower.sink = sink
        self._follower.keep_alive()
        hello = self._connect()
        try:
            self._configure()
            self._link.ask(Cmd.STATUS, StatusBody(0).pack())
        except BaseException:
            self._link.close()
            raise
        self._follower.ignore_past_triggers()
        return StageInfo(
            kind="uno",
            version=f"{hello.firmware_version // 100}.{hello.firmware_version % 100:02d}",
            boot_id=f"{hello.boot_id:08x}",
            counts_triggers=True,
            counts_strobes=True,
            has_limit_switch=self._has_switch,
            modes=("step", "fly"),
        )

    def _connect(self) -> HelloReplyBody:
        try:
            return self._link.open()
        except (LinkLostError, FirmwareMismatchError) as error:
            if self._config.port:
                raise
            raise type(error)(f"{error} (stage.port names none, and this is the only port found)") from None

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
        damaged = self._link.counters()["damaged"]
        return msgspec.structs.replace(self._follower.status(), damaged_blocks=damaged)

    def keep_alive(self) -> None:
        """Renew the motion lease; call it from the host's main loop."""
        self._follower.keep_alive()

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
        self._follower.sink(Moved(status.position_steps, status.position_trusted, status.zero_id, steps_lost=None))

    @property
    def _has_switch(self) -> bool:
        return self._config.limit_switch != "none"

    def begin_segment(self, segment: Segment, may_trigger_through: int) -> int:
        """Start a segment; the firmware runs it by itself as far as it is granted."""
        self._claim()
        try:
            segment_id, first_id = self._follower.prepare_segment(segment, may_trigger_through)
            body = segment_body(segment, segment_id, first_id)
            if may_trigger_through >= 0:
                self._link.send(Cmd.GRANT, GrantBody(first_id + may_trigger_through).pack())
            self._run("segment", Cmd.SEGMENT, body.pack())
        finally:
            self._follower.release()
        return first_id

    def grant(self, may_trigger_through: int) -> None:
        """Raise the absolute credit of the running segment."""
        self._link.send(Cmd.GRANT, GrantBody(self._follower.raise_credit(may_trigger_through)).pack())

    def hold(self) -> None:
        """Hold: by a realtime byte, and by a command in case noise destroys it."""
        if self._follower.want_hold(hold=True):
            self._link.realtime(bytes((RT_HOLD,)))
            self._link.send(Cmd.HOLD)

    def resume(self) -> None:
        """Continue after a hold."""
        self._follower.want_hold(hold=False)
        self._link.send(Cmd.RESUME)

    def stop(self) -> None:
        """Decelerate and end."""
        if self._follower.active:
            self._link.realtime(bytes((RT_STOP, RT_STOP_CONFIRM)))
        self._link.send(Cmd.STOP)

    def emergency_stop(self) -> None:
        """No step after this, driver and lamp off; the position is lost."""
        self._link.realtime(bytes((RT_ESTOP, RT_ESTOP_CONFIRM)))

    def set_lamp(self, *, on: bool) -> None:
        """Switch the lamp and wait until the firmware has done it, so that the next frame is taken in its light."""
        if result_of(self._link.ask(Cmd.LAMP, LampBody(int(on)).pack())) == Result.ALARM:
            raise CommandRefusedError("the lamp stays off: an alarm stands; release its cause, then home the stage")

    # ---- besides the protocol ----

    def diagnose(self) -> DiagnosisBody:
        """The firmware's own counters."""
        return DiagnosisBody.unpack(self._link.ask(Cmd.DIAGNOSE).body)

    def send(self, kind: Cmd, body: bytes = b"") -> Future[Block]:
        """Queue any command; the future holds the firmware's answer."""
        return self._link.send(kind, body)

    @property
    def report(self) -> ReportBody:
        """The firmware's last report."""
        return self._follower.report

    @property
    def strobes(self) -> int:
        """Strobes that the firmware has seen since its start."""
        return self._follower.strobes

    def counters(self) -> dict[str, int]:
        """Counters of the link, and strobes that the firmware has seen since its start."""
        return {**self._link.counters(), "strobes": self.strobes}

    # ---- starting an activity ----

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
        if self._follower.claim():
            try:
                self._clear_alarm()
            except BaseException:
                self._follower.release()
                raise

    def _clear_alarm(self) -> None:
        result = result_of(self._link.ask(Cmd.CLEAR))
        self._link.ask(Cmd.STATUS, StatusBody(self._follower.next_event).pack())
        if result != Result.OK:
            raise CommandRefusedError("the emergency stop is pressed: release it, then home the stage")

    def _start(self, activity: Activity, kind: Cmd, body: bytes = b"") -> None:
        self._claim()
        try:
            self._run(activity, kind, body)
        finally:
            self._follower.release()

    def _run(self, activity: Activity, kind: Cmd, body: bytes) -> None:
        """The activity begins with the acknowledgement, in the link's thread: every later report is about it."""
        self._follower.keep_alive()
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
            self._follower.started(activity)
