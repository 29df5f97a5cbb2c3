"""Numbers and message bodies of the serial protocol: firmware/protocol.h in Python.

A test compares every number and structure with the header; ``WIRE_CRC`` is the checksum of its declarations, which the
firmware repeats in its handshake, so that a driver never talks to a firmware with other declarations.
"""

from __future__ import annotations

import struct
from enum import IntEnum, IntFlag
from typing import ClassVar, Self

import msgspec

PROTOCOL_MAJOR = 1
PROTOCOL_MINOR = 0
WIRE_CRC = 0x13F9_A611
LINK_BAUD = 250_000
BODY_MAX = 89
COMMAND_BODY_MAX = 48
WINDOW_MAX = 4
RESULT_MEMORY = 8
EVENT_MEMORY = 32
REPORT_EVENTS_MAX = 2
TICKS_PER_S = 2_000_000
CYCLES_PER_TICK = 8

RT_HOLD = 0xF1
RT_STOP = 0xF2
RT_STOP_CONFIRM = 0x2D
RT_ESTOP = 0xF3
RT_ESTOP_CONFIRM = 0x3C

RATE_MIN, RATE_MAX = 1, 20_000
ACCEL_MIN, ACCEL_MAX = 100, 1_000_000
POSITION_MAX = 10_000_000
SHOTS_MAX = 100_000
WAIT_MAX_US = 60_000_000
PULSE_MIN_US, PULSE_MAX_US = 5, 10_000
LEASE_MIN_MS, LEASE_MAX_MS = 50, 60_000
STROBE_NONE = 0xFFFF_FFFF


class Cmd(IntEnum):
    """Blocks from the host."""

    HELLO = 1
    CONFIGURE = 2
    STATUS = 3
    MOVE = 4
    SEGMENT = 5
    GRANT = 6
    HOLD = 7
    RESUME = 8
    STOP = 9
    HOME = 10
    ZERO = 11
    TOUCH = 12
    LAMP = 13
    CLEAR = 14
    DIAGNOSE = 15
    EVENTS = 16


class Msg(IntEnum):
    """Blocks from the firmware."""

    HELLO = 0x80
    ACK = 0x81
    REPORT = 0x82
    DIAGNOSIS = 0x83


class Result(IntEnum):
    """What became of a command."""

    OK = 0
    BAD_BLOCK = 1
    GAP = 2
    NO_SESSION = 3
    UNKNOWN = 4
    RANGE = 5
    STATE = 6
    UNTRUSTED = 7
    ALARM = 8


class McuState(IntEnum):
    """What the firmware is doing."""

    IDLE = 0
    MOVING = 1
    SWEEPING = 2
    HOLDING = 3
    HOMING = 4
    ALARM = 5


class McuHold(IntEnum):
    """Why it holds."""

    NONE = 0
    HOST = 1
    REALTIME = 2
    NO_CREDIT = 3
    LEASE = 4


class McuStop(IntEnum):
    """Why it stopped last."""

    NONE = 0
    DONE = 1
    HOST = 2
    REALTIME = 3
    LEASE = 4
    ALARM = 5


class McuAlarm(IntEnum):
    """Why it stopped by itself."""

    NONE = 0
    ESTOP_PIN = 1
    ESTOP_BYTE = 2
    LIMIT = 3
    LATE_STEP = 4
    UNDERRUN = 5
    TRIGGER_OVERRUN = 6
    HOMING = 7
    RUN_UP = 8


class Flag(IntFlag):
    """Flags of a report."""

    TRUSTED = 1
    CONFIGURED = 2
    LAMP = 4
    LAMP_READY = 8
    LIMIT = 16
    ESTOP = 32
    DRIVER = 64
    TOUCHED = 128


class Reset(IntFlag):
    """Why the processor started."""

    POWER = 1
    EXTERNAL = 2
    BROWN_OUT = 4
    WATCHDOG = 8


class ConfigFlag(IntFlag):
    """Wiring that the configuration names."""

    INVERT_DIRECTION = 1
    LIMIT_CLOSES = 2
    ESTOP_CLOSES = 4
    HOME_POSITIVE = 8
    NO_LIMIT = 16
    STROBE_FALLS = 32


class Mode(IntEnum):
    """How a segment takes its shots."""

    STEP = 0
    FLY = 1


class Body(msgspec.Struct, frozen=True):
    """A packed little-endian structure; the fields are in the order of the format."""

    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<")

    def pack(self) -> bytes:
        """Bytes of the body.

        Raises:
            ValueError: a field does not fit into its type on the wire.
        """
        try:
            return self.LAYOUT.pack(*msgspec.structs.astuple(self))
        except struct.error as error:
            raise ValueError(f"{type(self).__name__}: {error}") from error

    @classmethod
    def unpack(cls, data: bytes, offset: int = 0) -> Self:
        """The structure that begins at ``offset``.

        Raises:
            ValueError: too few bytes.
        """
        try:
            return cls(*cls.LAYOUT.unpack_from(data, offset))
        except struct.error as error:
            raise ValueError(f"{cls.__name__}: {error}") from error


class HelloBody(Body, frozen=True):
    """The host opens a session; the nonce (not 0) names it."""

    LAYOUT = struct.Struct("<BBI")
    major: int
    minor: int
    nonce: int


class ConfigBody(Body, frozen=True):
    """The motion's limits; see protocol.h for the units."""

    LAYOUT = struct.Struct("<HIHHiiiHHHHIB")
    max_rate: int
    acceleration: int
    home_fast: int
    home_slow: int
    home_position: int
    soft_min: int
    soft_max: int
    overtravel: int
    backoff: int
    trigger_pulse_us: int
    lease_ms: int
    lamp_warm_up_ms: int
    flags: int


class StatusBody(Body, frozen=True):
    """Ask for a report; the host has all events below this id."""

    LAYOUT = struct.Struct("<I")
    events_seen: int


class MoveBody(Body, frozen=True):
    """Move to a place, or by a distance."""

    LAYOUT = struct.Struct("<iBH")
    target: int
    relative: int
    rate: int


class SegmentBody(Body, frozen=True):
    """Shots that the firmware takes by itself."""

    LAYOUT = struct.Struct("<HIiiIBIIIHH")
    segment_id: int
    first_trigger_id: int
    first: int
    pitch: int
    count: int
    mode: int
    settle_us: int
    dwell_us: int
    shot_period_us: int
    run_up: int
    resume_credit: int


class GrantBody(Body, frozen=True):
    """The absolute credit, as a trigger id; -1: nothing."""

    LAYOUT = struct.Struct("<i")
    may_trigger_through: int


class ZeroBody(Body, frozen=True):
    """Call the present place this position."""

    LAYOUT = struct.Struct("<i")
    position: int


class LampBody(Body, frozen=True):
    """Switch the lamp."""

    LAYOUT = struct.Struct("<B")
    on: int


class EventsBody(Body, frozen=True):
    """Ask for the events from this trigger id on."""

    LAYOUT = struct.Struct("<I")
    first: int


class AckBody(Body, frozen=True):
    """What became of the command, and which sequence comes next."""

    LAYOUT = struct.Struct("<BB")
    result: int
    expected_sequence: int


class HelloReplyBody(Body, frozen=True):
    """Who the firmware is."""

    LAYOUT = struct.Struct("<BBHIIIIB")
    major: int
    minor: int
    firmware_version: int
    wire_crc: int
    config_crc: int
    boot_id: int
    previous_nonce: int
    reset_cause: int


class ReportBody(Body, frozen=True):
    """Where everything is."""

    LAYOUT = struct.Struct("<6BiIIiHIIiQB")
    expected_sequence: int
    state: int
    hold_reason: int
    stop_reason: int
    alarm: int
    flags: int
    position: int
    triggers: int
    strobes: int
    may_trigger_through: int
    segment_id: int
    shots_left: int
    zero_id: int
    steps_lost: int
    cycles: int
    event_count: int


class EventBody(Body, frozen=True):
    """One trigger."""

    LAYOUT = struct.Struct("<IiQIH")
    trigger_id: int
    position: int
    cycles: int
    strobe_delay_us: int
    segment_id: int


class DiagnosisBody(Body, frozen=True):
    """Counters that tell how the link and the processor fare."""

    LAYOUT = struct.Struct("<HHH6IB")
    stack_free_min: int
    ram_size: int
    loop_max_us: int
    commands_run: int
    duplicates: int
    gaps: int
    damaged: int
    receive_overruns: int
    replies_dropped: int
    reset_cause: int


def unpack_report(body: bytes) -> tuple[ReportBody, tuple[EventBody, ...]]:
    """A report and the trigger events that it carries.

    Raises:
        ValueError: the body's size does not fit its counts.
    """
    report = ReportBody.unpack(body)
    size, head = EventBody.LAYOUT.size, ReportBody.LAYOUT.size
    if len(body) != head + report.event_count * size:
        raise ValueError(f"a report of {len(body)} bytes names {report.event_count} events")
    return report, tuple(EventBody.unpack(body, head + index * size) for index in range(report.event_count))
