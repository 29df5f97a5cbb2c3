#include "machine.h"

#include "clock.h"
#include "motion.h"
#include "pins.h"
#include "steps.h"

struct machine machine = {
    .config = {.max_rate = 2000, .acceleration = 20000, .home_fast = 1000, .home_slow = 100, .home_position = -100,
               .soft_min = 0, .soft_max = 4500, .overtravel = 100, .backoff = 50,
               .trigger_pulse_us = 100, .lease_ms = 500, .lamp_warm_up_ms = 0, .flags = 0},
};

void machine_init(uint32_t boot_id)
{
    machine.boot_id = boot_id;
    motion_configure(&machine.config);
    steps_pulse(machine.config.trigger_pulse_us);
}

void machine_heard(void)
{
    machine.heard_ms = clock_ms();
}

uint8_t machine_flags(void)
{
    uint8_t flags = machine.flags;

    if ((flags & FLAG_LAMP) && clock_ms() - machine.lamp_on_ms >= machine.config.lamp_warm_up_ms)
        flags |= FLAG_LAMP_READY;
    if (clock_limit())
        flags |= FLAG_LIMIT;
    if (clock_estop())
        flags |= FLAG_ESTOP;
    return flags;
}

static uint8_t homing(void)
{
    return machine.phase >= PHASE_HOME_FAST;
}

uint8_t machine_ready(void)
{
    if (machine.state == STATE_ALARM)
        return RESULT_ALARM;
    if (machine.state != STATE_IDLE || !(machine.flags & FLAG_CONFIGURED))
        return RESULT_STATE;
    return RESULT_OK;
}

void machine_begin(uint8_t state, enum phase phase)
{
    machine.state = state;
    machine.phase = phase;
    machine.hold_reason = HOLD_NONE;
    machine.flags &= ~FLAG_TOUCHED;
}

void machine_end(uint8_t stop_reason)
{
    machine.state = STATE_IDLE;
    machine.phase = PHASE_NONE;
    machine.hold_reason = HOLD_NONE;
    machine.stop_reason = stop_reason;
}

void machine_trust(int32_t position)
{
    steps_set_position(position);
    machine.flags |= FLAG_TRUSTED;
    machine.zero_id = machine.boot_id << 8 | ++machine.zeros;
}

static uint8_t config_in_range(const struct config_body *c)
{
    return c->max_rate >= RATE_MIN && c->max_rate <= RATE_MAX && c->acceleration >= ACCEL_MIN
        && c->acceleration <= ACCEL_MAX && c->home_fast >= RATE_MIN && c->home_fast <= c->max_rate
        && c->home_slow >= RATE_MIN && c->home_slow <= c->home_fast && c->soft_min < c->soft_max
        && c->soft_min >= -POSITION_MAX && c->soft_max <= POSITION_MAX && c->home_position >= -POSITION_MAX
        && c->home_position <= POSITION_MAX && c->trigger_pulse_us >= PULSE_MIN_US
        && c->trigger_pulse_us <= PULSE_MAX_US && c->lease_ms >= LEASE_MIN_MS && c->lease_ms <= LEASE_MAX_MS
        && c->backoff >= 1;
}

uint8_t machine_configure(const struct config_body *config)
{
    if (machine.state != STATE_IDLE && machine.state != STATE_ALARM)
        return RESULT_STATE;
    if (!config_in_range(config))
        return RESULT_RANGE;
    if (config->flags != machine.config.flags)
        machine.flags &= ~FLAG_TRUSTED; /* another direction or switch: the old zero means nothing */
    machine.config = *config;
    motion_configure(config);
    steps_pulse(config->trigger_pulse_us);
    steps_strobe_falls(config->flags & CONFIG_STROBE_FALLS);
    clock_switches(config->flags & CONFIG_LIMIT_CLOSES, config->flags & CONFIG_ESTOP_CLOSES,
                   !(config->flags & CONFIG_NO_LIMIT));
    machine.flags |= FLAG_CONFIGURED | FLAG_DRIVER;
    pins_driver(1);
    return RESULT_OK;
}

uint8_t machine_move(const struct move_body *move)
{
    uint8_t result = machine_ready();
    int32_t target = move->target;

    if (result != RESULT_OK)
        return result;
    if (target < -POSITION_MAX || target > POSITION_MAX || move->rate > RATE_MAX)
        return RESULT_RANGE;
    if (move->relative)
        target += steps_position();
    if ((machine.flags & FLAG_TRUSTED) && (target < machine.config.soft_min || target > machine.config.soft_max))
        return RESULT_RANGE;
    machine_begin(STATE_MOVING, PHASE_MOVE);
    motion_move(target, move->rate);
    return RESULT_OK;
}

uint8_t machine_hold(uint8_t reason)
{
    if (machine.state != STATE_SWEEPING && machine.state != STATE_HOLDING)
        return RESULT_STATE;
    sweep_hold(reason);
    return RESULT_OK;
}

uint8_t machine_resume(void)
{
    if (machine.state != STATE_HOLDING && machine.phase != PHASE_BRAKE)
        return RESULT_STATE;
    sweep_resume();
    return RESULT_OK;
}

uint8_t machine_stop(uint8_t reason)
{
    if (machine.state == STATE_ALARM)
        return RESULT_ALARM;
    if (machine.state == STATE_IDLE)
        return RESULT_OK; /* already at rest: asking again is no fault */
    machine.last_stop = reason;
    if (machine.phase == PHASE_SETTLE || machine.phase == PHASE_DWELL)
        motion_kill(); /* at rest, only the pause is cut */
    motion_halt();
    machine.phase = PHASE_STOPPING;
    return RESULT_OK;
}

uint8_t machine_zero(int32_t position)
{
    uint8_t result = machine_ready();

    if (result != RESULT_OK)
        return result;
    if (position < -POSITION_MAX || position > POSITION_MAX)
        return RESULT_RANGE;
    machine_trust(position);
    return RESULT_OK;
}

uint8_t machine_lamp(uint8_t on)
{
    if (on && machine.state == STATE_ALARM)
        return RESULT_ALARM;
    if (on && !(machine.flags & FLAG_LAMP))
        machine.lamp_on_ms = clock_ms();
    machine.flags = on ? machine.flags | FLAG_LAMP : machine.flags & ~FLAG_LAMP;
    pins_lamp(on);
    return RESULT_OK;
}

uint8_t machine_clear(void)
{
    if (clock_estop())
        return RESULT_ALARM;
    if (machine.state != STATE_ALARM)
        return RESULT_OK;
    machine.alarm = ALARM_NONE;
    machine.state = STATE_IDLE;
    if (machine.flags & FLAG_CONFIGURED) {
        machine.flags |= FLAG_DRIVER;
        pins_driver(1);
    }
    return RESULT_OK;
}

void machine_alarm(uint8_t code)
{
    uint8_t emergency = code == ALARM_ESTOP_PIN || code == ALARM_ESTOP_BYTE;

    motion_kill();
    if (machine.alarm == ALARM_NONE || emergency)
        machine.alarm = code; /* else the first one is the cause */
    machine_end(STOP_ALARM);
    machine.state = STATE_ALARM;
    machine.flags &= ~FLAG_TRUSTED;
    if (emergency) {
        machine_lamp(0);
        pins_driver(0);
        machine.flags &= ~FLAG_DRIVER;
    }
}

static uint8_t running_into_limit(void)
{
    int8_t home = machine.config.flags & CONFIG_HOME_POSITIVE ? 1 : -1;

    return !homing() && clock_limit() && !motion_idle() && motion_direction() == home;
}

static void check_alarms(void)
{
    uint8_t code = steps_alarm();

    if (clock_estop() && machine.alarm != ALARM_ESTOP_PIN && machine.alarm != ALARM_ESTOP_BYTE)
        machine_alarm(ALARM_ESTOP_PIN);
    if (code != ALARM_NONE)
        machine_alarm(code);
    if (running_into_limit())
        machine_alarm(ALARM_LIMIT);
}

static void check_lease(void)
{
    if (machine.state == STATE_IDLE || machine.state == STATE_ALARM
        || clock_ms() - machine.heard_ms <= machine.config.lease_ms)
        return;
    if (machine.state == STATE_MOVING || machine.state == STATE_HOMING) {
        if (machine.phase != PHASE_STOPPING)
            machine_stop(STOP_LEASE);
    } else if (machine.hold_reason != HOLD_LEASE) {
        machine_hold(HOLD_LEASE);
    }
}

void machine_poll(void)
{
    check_alarms();
    check_lease();
    if (homing())
        homing_poll();
    else if (motion_idle()) {
        if (machine.phase == PHASE_MOVE)
            machine_end(STOP_DONE);
        else if (machine.phase == PHASE_STOPPING)
            machine_end(machine.last_stop);
        else
            sweep_advance();
    }
    motion_pump();
}
