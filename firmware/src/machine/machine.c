#include "machine.h"

#include "board/pins.h"
#include "inputs/clock.h"
#include "motion/motion.h"
#include "motion/steps.h"

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
