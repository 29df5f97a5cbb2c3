#include "motion.h"

#include <stddef.h>

#include "board/pins.h"
#include "ramp.h"
#include "steps.h"

#define PUMP_BUDGET 16    /* pieces planned in one go */
#define SLACK_TICKS 512   /* pieces as long as this leave time for anything */
#define SLACK_ENTRIES 24  /* of shorter ones so many must wait: 1.2 ms at the highest rate, more than a block takes */
#define CHUNK_TICKS 15000 /* long intervals are cut into pieces of this */

static struct profile profile;
static uint32_t constant, fastest;
static uint32_t pending;        /* ticks not yet queued */
static uint8_t pending_flags, planning;
static uint8_t inverted;
static uint16_t last_ticks;     /* of the newest piece */
static uint8_t (*flags_of_step)(int32_t position); /* of a move on the fly; else NULL */

void motion_configure(const struct config_body *config)
{
    constant = ramp_constant(config->acceleration);
    fastest = ramp_rate_interval(config->max_rate);
    inverted = config->flags & CONFIG_INVERT_DIRECTION;
}

static void begin(int32_t target, uint32_t cruise)
{
    profile.position = steps_position();
    if (target == profile.position)
        return;
    profile_start(&profile, target, constant, cruise);
    steps_direction(profile.direction, inverted);
    steps_unlock();
    pending = 0;
    planning = 1;
}

void motion_move(int32_t target, uint16_t rate)
{
    uint32_t cruise = rate ? ramp_rate_interval(rate) : fastest;

    flags_of_step = NULL;
    begin(target, cruise > fastest ? cruise : fastest);
}

void motion_fly(int32_t target, uint32_t cruise, uint8_t (*planned_step)(int32_t position))
{
    flags_of_step = planned_step;
    begin(target, cruise);
}

void motion_wait(uint32_t ticks, uint8_t flags)
{
    profile.position = profile.target = steps_position();
    flags_of_step = NULL;
    pending = ticks < STEPS_TICKS_MIN ? STEPS_TICKS_MIN : ticks;
    pending_flags = flags | ENTRY_LAST;
    steps_unlock();
    planning = 1;
}

void motion_halt(void)
{
    if (planning)
        profile_halt(&profile);
}

void motion_kill(void)
{
    planning = 0;
    steps_kill();
    pending = 0;
}

/* Few entries when intervals are long, so that a hold is heard soon; enough always for the longest pass of the loop. */
static uint8_t depth(uint16_t ticks)
{
    return ticks >= 4096 ? 2 : ticks >= 1024 ? 8 : STEPS_QUEUE - 1;
}

uint8_t motion_slack(void)
{
    return !planning || last_ticks >= SLACK_TICKS || steps_queued() >= SLACK_ENTRIES;
}

static uint8_t push_pending(void)
{
    uint16_t ticks = pending > STEPS_TICKS_MAX ? CHUNK_TICKS : (uint16_t)pending;

    last_ticks = ticks;

    if (steps_queued() >= depth(ticks))
        return 0;
    pending -= ticks;
    steps_push(ticks, pending ? 0 : pending_flags);
    return 1;
}

static void plan_step(void)
{
    pending = profile_next(&profile);
    if (!pending) {
        planning = 0;
        return;
    }
    pending_flags = ENTRY_STEP;
    if (flags_of_step)
        pending_flags |= flags_of_step(profile.position);
    if (profile.position == profile.target)
        pending_flags |= ENTRY_LAST;
}

void motion_pump(void)
{
    /* Bounded: where planning is hardly faster than the steps, switches and serial line must have their turn too. */
    for (uint8_t budget = PUMP_BUDGET; planning && budget; budget--) {
        if (!pending) {
            plan_step();
            continue;
        }
        if (!push_pending())
            break;
    }
    steps_start();
}

uint8_t motion_idle(void)
{
    return !planning && steps_idle();
}

uint8_t motion_cruising(void)
{
    return profile.cruising;
}

int8_t motion_direction(void)
{
    return profile.direction;
}

uint16_t motion_run_up(uint32_t cruise)
{
    return ramp_distance(constant, cruise);
}

uint32_t motion_fly_interval(uint32_t period_us, uint32_t pitch)
{
    return (uint32_t)((uint64_t)period_us * (TICKS_PER_S / 1000000 * 256) / pitch);
}
