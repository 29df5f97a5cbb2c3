#include "commands.h"

#include "board/pins.h"
#include "inputs/clock.h"
#include "machine.h"
#include "motion/motion.h"
#include "motion/steps.h"
#include "sweep.h"

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

uint8_t command_configure(const struct config_body *config)
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

uint8_t command_move(const struct move_body *move)
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

uint8_t command_hold(uint8_t reason)
{
    if (machine.state != STATE_SWEEPING && machine.state != STATE_HOLDING)
        return RESULT_STATE;
    sweep_hold(reason);
    return RESULT_OK;
}

uint8_t command_resume(void)
{
    if (machine.state != STATE_HOLDING && machine.phase != PHASE_BRAKE)
        return RESULT_STATE;
    sweep_resume();
    return RESULT_OK;
}

uint8_t command_stop(uint8_t reason)
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

uint8_t command_zero(int32_t position)
{
    uint8_t result = machine_ready();

    if (result != RESULT_OK)
        return result;
    if (position < -POSITION_MAX || position > POSITION_MAX)
        return RESULT_RANGE;
    machine_trust(position);
    return RESULT_OK;
}

uint8_t command_clear(void)
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
