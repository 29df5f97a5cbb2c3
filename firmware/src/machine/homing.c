#include "homing.h"

#include "inputs/clock.h"
#include "machine.h"
#include "motion/motion.h"
#include "motion/steps.h"

#define BACKOFF_TRIES 20
#define CONTACT_MS 30 /* a contact that has not settled by then was noise */

static uint8_t touching, tries;
static int32_t contact;
static uint32_t contact_ms;

static int8_t toward(void)
{
    return machine.config.flags & CONFIG_HOME_POSITIVE ? 1 : -1;
}

static void move_by(int32_t steps, uint16_t rate)
{
    motion_move(steps_position() + steps, rate);
}

static void back_off(void)
{
    machine.phase = PHASE_HOME_BACKOFF;
    move_by(-(int32_t)toward() * machine.config.backoff, machine.config.home_fast);
}

static void seek_slowly(void)
{
    machine.phase = PHASE_HOME_SLOW;
    clock_watch_contact();
    move_by((int32_t)toward() * 4 * machine.config.backoff, machine.config.home_slow);
}

uint8_t homing_begin(uint8_t touch)
{
    const struct config_body *c = &machine.config;
    uint8_t result = machine_ready();

    if (result != RESULT_OK)
        return result;
    if (c->flags & CONFIG_NO_LIMIT)
        return RESULT_STATE;
    if (touch && !(machine.flags & FLAG_TRUSTED))
        return RESULT_UNTRUSTED;
    touching = touch;
    tries = 0;
    machine_begin(STATE_HOMING, touch ? PHASE_TOUCH_APPROACH : PHASE_HOME_FAST);
    if (clock_limit())
        back_off();
    else if (touch)
        motion_move(c->home_position - (int32_t)toward() * c->backoff, 0);
    else
        move_by((int32_t)toward() * (c->soft_max - c->soft_min + 2L * c->overtravel + 1000), c->home_fast);
    return RESULT_OK;
}

static void leave(void)
{
    const struct config_body *c = &machine.config;

    if (touching) {
        machine.steps_lost = contact - c->home_position;
        machine.flags |= FLAG_TOUCHED;
    } else {
        machine_trust(steps_position() - contact + c->home_position);
        contact = c->home_position;
    }
    machine.phase = PHASE_HOME_LEAVE;
    motion_move(contact - (int32_t)toward() * c->backoff, c->home_fast);
}

static void poll_moving(void)
{
    if (machine.phase == PHASE_HOME_SLOW) {
        if (clock_contact(&contact)) {
            motion_halt();
            contact_ms = clock_ms();
            machine.phase = PHASE_HOME_SETTLE;
        }
    } else if (machine.phase != PHASE_HOME_BACKOFF && machine.phase != PHASE_HOME_LEAVE
               && machine.phase != PHASE_HOME_SETTLE && clock_limit()) {
        motion_halt();
        machine.phase = PHASE_HOME_BRAKE;
    }
}

static void settle_contact(void)
{
    if (clock_limit())
        leave();
    else if (clock_ms() - contact_ms > CONTACT_MS)
        seek_slowly();
}

void homing_poll(void)
{
    poll_moving();
    if (!motion_idle())
        return;
    switch (machine.phase) {
    case PHASE_TOUCH_APPROACH:
        seek_slowly();
        break;
    case PHASE_HOME_BRAKE:
        back_off();
        break;
    case PHASE_HOME_BACKOFF:
        if (!clock_limit())
            seek_slowly();
        else if (++tries < BACKOFF_TRIES)
            back_off();
        else
            machine_alarm(ALARM_HOMING);
        break;
    case PHASE_HOME_SETTLE:
        settle_contact();
        break;
    case PHASE_HOME_LEAVE:
        machine_end(STOP_DONE);
        break;
    default: /* travelled the whole way without meeting the switch */
        machine_alarm(ALARM_HOMING);
    }
}
