"""Converts [stage] and segments to the firmware's structures; refuses what is out of bounds before it is sent."""

from __future__ import annotations

from acquire.contract.config.model import StageConfig
from acquire.contract.errors import CommandRefusedError, ConfigError
from acquire.stages.protocol import Segment

from .wire_format import (
    ACCEL_MAX,
    ACCEL_MIN,
    LEASE_MAX_MS,
    LEASE_MIN_MS,
    RATE_MAX,
    RATE_MIN,
    SHOTS_MAX,
    WAIT_MAX_US,
    ConfigBody,
    ConfigFlag,
    Mode,
    SegmentBody,
)

_SWITCH_GAP_STEPS = 16
"""Between the farthest run-up and the switch's edge."""
_HOME_SLOW_RATE = 100
"""Microsteps per second of the touch: below the tick of 1 ms per microstep, so the edge is exact."""
_BACKOFF_STEPS = 50
_TRIGGER_PULSE_US = 100
_FLY_RESUME_SHOTS = 8


def switch_position_steps(config: StageConfig) -> int:
    """Position of the limit switch's edge: beyond the run-up of a sweep that begins at that end of the travel."""
    beyond = config.run_up_steps + 2 * _SWITCH_GAP_STEPS
    return config.travel_max_steps + beyond if config.limit_switch == "far" else config.travel_min_steps - beyond


def wiring_flags(config: StageConfig) -> ConfigFlag:
    """The wiring, as flags of the firmware's configuration."""
    named = {
        ConfigFlag.INVERT_DIRECTION: config.invert_direction,
        ConfigFlag.LIMIT_CLOSES: config.limit_closes,
        ConfigFlag.ESTOP_CLOSES: config.estop_closes,
        ConfigFlag.HOME_POSITIVE: config.limit_switch == "far",
        ConfigFlag.NO_LIMIT: config.limit_switch == "none",
        ConfigFlag.STROBE_FALLS: config.strobe_falls,
    }
    return ConfigFlag(sum(flag for flag, wanted in named.items() if wanted))


def config_body(config: StageConfig) -> ConfigBody:
    """The firmware's configuration.

    Raises:
        ConfigError: a value is out of the firmware's bounds.
    """
    rate = _within("stage.max_rate_steps_per_s", config.max_rate_steps_per_s, RATE_MIN, RATE_MAX)
    return ConfigBody(
        max_rate=rate,
        acceleration=_within("stage.acceleration_steps_per_s2", config.acceleration_steps_per_s2, ACCEL_MIN, ACCEL_MAX),
        home_fast=max(rate // 2, min(rate, _HOME_SLOW_RATE)),
        home_slow=min(_HOME_SLOW_RATE, max(rate // 2, 1)),
        home_position=switch_position_steps(config),
        soft_min=config.travel_min_steps,
        soft_max=config.travel_max_steps,
        overtravel=config.run_up_steps + _SWITCH_GAP_STEPS,
        backoff=_BACKOFF_STEPS,
        trigger_pulse_us=_TRIGGER_PULSE_US,
        lease_ms=_within("stage.motion_lease_ms", config.motion_lease_ms, LEASE_MIN_MS, LEASE_MAX_MS),
        lamp_warm_up_ms=0,
        flags=int(wiring_flags(config)),
    )


def segment_body(segment: Segment, segment_id: int, first_trigger_id: int) -> SegmentBody:
    """The firmware's segment.

    Raises:
        CommandRefusedError: more shots or longer waits than the firmware takes.
    """
    if not 1 <= segment.count <= SHOTS_MAX:
        raise CommandRefusedError(f"a segment has 1 to {SHOTS_MAX} shots, not {segment.count}")
    return SegmentBody(
        segment_id=segment_id,
        first_trigger_id=first_trigger_id,
        first=segment.first_steps,
        pitch=segment.pitch_steps,
        count=segment.count,
        mode=Mode.FLY if segment.mode == "fly" else Mode.STEP,
        settle_us=_wait_us("settle", segment.settle_ms),
        dwell_us=_wait_us("dwell", segment.dwell_ms),
        shot_period_us=_wait_us("period", segment.period_ms),
        run_up=segment.run_up_steps,
        resume_credit=_FLY_RESUME_SHOTS if segment.mode == "fly" else 1,
    )


def _within(name: str, value: float, low: int, high: int) -> int:
    if not low <= value <= high:
        raise ConfigError(f"{name} = {value:g} is outside what the firmware can do: {low} to {high}")
    return round(value)


def _wait_us(name: str, value_ms: float) -> int:
    value_us = round(value_ms * 1000)
    if not 0 <= value_us <= WAIT_MAX_US:
        raise CommandRefusedError(f"a {name} of {value_ms} ms is longer than the stage can wait")
    return value_us
