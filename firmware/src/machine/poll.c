#include "poll.h"

#include "commands.h"
#include "homing.h"
#include "inputs/clock.h"
#include "machine.h"
#include "motion/motion.h"
#include "motion/steps.h"
#include "sweep.h"

static uint8_t homing(void)
{
    return machine.phase >= PHASE_HOME_FAST;
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
            command_stop(STOP_LEASE);
    } else if (machine.hold_reason != HOLD_LEASE) {
        command_hold(HOLD_LEASE);
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
