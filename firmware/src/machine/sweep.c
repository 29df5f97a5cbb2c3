#include "sweep.h"

#include <util/atomic.h>

#include "machine.h"
#include "motion/ledger.h"
#include "motion/motion.h"
#include "motion/steps.h"

#define FIRE_TICKS 100 /* from the decision to the edge where no settling is asked for */

static struct segment_body segment;
static uint32_t first_id;    /* trigger id of shot 0 */
static uint32_t planned;     /* shots fired or queued */
static uint32_t fly_cruise;
static int32_t next_shot;    /* position of shot number planned, in fly mode */
static uint8_t after_hold, must_approach;

static uint32_t fired(void)
{
    uint32_t n;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        n = steps_ledger.fired;
    }
    return n;
}

static int8_t direction(void)
{
    return segment.pitch < 0 ? -1 : 1;
}

static int32_t shot_position(uint32_t shot)
{
    return segment.first + segment.pitch * (int32_t)shot;
}

uint32_t sweep_shots_left(void)
{
    return segment.count - (fired() - first_id);
}

uint16_t sweep_segment_id(void)
{
    return segment.segment_id;
}

static uint8_t outside(int32_t position, int32_t margin)
{
    return position < machine.config.soft_min - margin || position > machine.config.soft_max + margin;
}

static uint8_t numbers_in_range(const struct segment_body *s)
{
    if (s->count < 1 || s->count > SHOTS_MAX || s->mode > MODE_FLY || s->pitch > POSITION_MAX
        || s->pitch < -POSITION_MAX || s->first > POSITION_MAX || s->first < -POSITION_MAX)
        return 0;
    if (s->settle_us > WAIT_MAX_US || s->dwell_us > WAIT_MAX_US || s->shot_period_us > WAIT_MAX_US)
        return 0;
    int64_t last = s->first + (int64_t)s->pitch * (s->count - 1);
    return last <= POSITION_MAX && last >= -POSITION_MAX && !outside(s->first, 0) && !outside((int32_t)last, 0);
}

static uint8_t fly_in_range(const struct segment_body *s)
{
    uint32_t pitch = s->pitch < 0 ? -s->pitch : s->pitch;

    if (pitch == 0 || s->shot_period_us < 2UL * machine.config.trigger_pulse_us)
        return 0;
    fly_cruise = motion_fly_interval(s->shot_period_us, pitch);
    return fly_cruise >= (uint32_t)TICKS_PER_S * 256 / machine.config.max_rate;
}

static int32_t run_up(void)
{
    uint16_t ramp = segment.mode == MODE_FLY ? motion_run_up(fly_cruise) : 0;

    return (int32_t)direction() * ((int32_t)ramp + segment.run_up);
}

static void start_pass(void)
{
    planned = fired() - first_id;
    machine.state = STATE_SWEEPING;
    if (segment.mode == MODE_STEP && !must_approach) {
        machine.phase = PHASE_CREDIT;
        return;
    }
    must_approach = 0;
    machine.phase = segment.mode == MODE_FLY ? PHASE_BACKUP : PHASE_APPROACH;
    motion_move(shot_position(planned) - run_up(), 0);
}

uint8_t sweep_begin(const struct segment_body *s)
{
    uint8_t result = machine_ready();

    if (result != RESULT_OK)
        return result;
    if (!(machine.flags & FLAG_TRUSTED))
        return RESULT_UNTRUSTED;
    if (s->first_trigger_id != fired())
        return RESULT_STATE;
    if (!numbers_in_range(s) || (s->mode == MODE_FLY && !fly_in_range(s)))
        return RESULT_RANGE;
    segment = *s;
    if (outside(segment.first - run_up(), machine.config.overtravel)
        || outside(shot_position(segment.count - 1) + run_up(), machine.config.overtravel)) {
        segment.count = 0;
        first_id = fired();
        return RESULT_RANGE;
    }
    first_id = fired();
    steps_segment(segment.segment_id);
    after_hold = 0;
    must_approach = 1;
    machine_begin(STATE_SWEEPING, PHASE_NONE);
    start_pass();
    return RESULT_OK;
}

static uint8_t credit(void)
{
    uint32_t left = segment.count - planned;
    uint32_t wanted = after_hold && segment.resume_credit ? segment.resume_credit : 1;
    uint32_t have;

    if (wanted > EVENT_MEMORY / 2)
        wanted = EVENT_MEMORY / 2;
    if (wanted > left)
        wanted = left;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        have = ledger_credit(&steps_ledger, first_id + planned, wanted);
    }
    return have >= wanted;
}

/* Called for each planned step on the fly; returns the ENTRY_ flags of that step. */
static uint8_t planned_step(int32_t position)
{
    uint8_t may;

    if (position != next_shot || machine.phase != PHASE_FLY)
        return 0;
    if (!motion_cruising())
        return 0; /* comes to rest in PHASE_FLY: an alarm */
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        may = ledger_may(&steps_ledger, first_id + planned);
    }
    if (!may) {
        machine.hold_reason = HOLD_NO_CREDIT;
        machine.phase = PHASE_BRAKE;
        motion_halt();
        return 0;
    }
    next_shot += segment.pitch;
    if (++planned == segment.count) {
        machine.phase = PHASE_FINISH;
        motion_halt();
    }
    return ENTRY_TRIGGER;
}

static void wait_credit(void)
{
    if (!credit()) {
        after_hold = 1;
        machine.state = STATE_HOLDING;
        machine.hold_reason = HOLD_NO_CREDIT;
        return;
    }
    after_hold = 0;
    machine.state = STATE_SWEEPING;
    machine.hold_reason = HOLD_NONE;
    if (segment.mode == MODE_FLY) {
        machine.phase = PHASE_FLY;
        next_shot = shot_position(planned);
        motion_fly(shot_position(segment.count - 1) + run_up(), fly_cruise, planned_step);
    } else {
        machine.phase = PHASE_STEP;
        motion_move(shot_position(planned), 0);
    }
}

/* Ticks since the last trigger, capped at 32 bits. */
static uint32_t ticks_since_trigger(void)
{
    uint64_t now = steps_cycles() / CYCLES_PER_TICK;
    const struct event *last;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        last = ledger_event(&steps_ledger, steps_ledger.fired - 1);
    }
    if (!last)
        return UINT32_MAX;
    uint64_t ago = now - ((uint64_t)last->ticks_high << 16 | last->ticks_low); /* at rest: no trigger is written */
    return ago > UINT32_MAX ? UINT32_MAX : (uint32_t)ago;
}

static void fire_after_settling(void)
{
    uint32_t ticks = segment.settle_us * (TICKS_PER_S / 1000000);
    uint32_t period = segment.shot_period_us * (TICKS_PER_S / 1000000);
    uint32_t ago = ticks_since_trigger();

    if (period > ago && period - ago > ticks)
        ticks = period - ago;

    machine.phase = PHASE_SETTLE;
    motion_wait(ticks > FIRE_TICKS ? ticks : FIRE_TICKS, ENTRY_TRIGGER);
}

static void after_shot(void)
{
    planned = fired() - first_id;
    if (machine.hold_reason != HOLD_NONE) {
        machine.state = STATE_HOLDING;
        machine.phase = PHASE_HOLD;
    } else if (planned == segment.count) {
        machine_end(STOP_DONE);
    } else {
        machine.phase = PHASE_CREDIT;
    }
}

static void come_to_hold(void)
{
    if (machine.hold_reason == HOLD_NONE) {
        start_pass(); /* resumed while it braked */
    } else if (machine.hold_reason == HOLD_NO_CREDIT) {
        after_hold = 1;
        start_pass(); /* back to where the run-up begins; there it waits */
    } else {
        machine.state = STATE_HOLDING;
        machine.phase = PHASE_HOLD;
    }
}

void sweep_advance(void)
{
    switch (machine.phase) {
    case PHASE_APPROACH:
    case PHASE_BACKUP:
        machine.phase = PHASE_CREDIT;
        break;
    case PHASE_CREDIT:
        wait_credit();
        break;
    case PHASE_STEP:
        fire_after_settling();
        break;
    case PHASE_SETTLE:
        machine.phase = PHASE_DWELL;
        if (segment.dwell_us)
            motion_wait(segment.dwell_us * (TICKS_PER_S / 1000000), 0);
        break;
    case PHASE_DWELL:
        after_shot();
        break;
    case PHASE_FINISH:
        machine_end(STOP_DONE);
        break;
    case PHASE_FLY: /* at rest without having reached the last shot */
        machine_alarm(ALARM_RUN_UP);
        break;
    case PHASE_BRAKE:
        come_to_hold();
        break;
    default:
        break;
    }
}

void sweep_hold(uint8_t reason)
{
    uint8_t first = machine.hold_reason == HOLD_NONE || machine.hold_reason == HOLD_NO_CREDIT;

    if (first || reason == HOLD_LEASE)
        machine.hold_reason = reason;
    switch (machine.phase) {
    case PHASE_CREDIT:
        machine.state = STATE_HOLDING;
        machine.phase = PHASE_HOLD;
        break;
    case PHASE_SETTLE:
        motion_kill();
        if (fired() - first_id == planned)
            machine.phase = PHASE_DWELL; /* nothing to wait for; else it fired just now, and dwells as always */
        break;
    case PHASE_APPROACH:
    case PHASE_BACKUP:
        must_approach = 1;
        /* fall through */
    case PHASE_STEP:
    case PHASE_FLY:
        motion_halt();
        machine.phase = PHASE_BRAKE;
        break;
    default:
        break; /* a shot under way or a hold already: the reason is enough */
    }
}

void sweep_resume(void)
{
    machine.hold_reason = HOLD_NONE;
    if (machine.phase == PHASE_HOLD)
        start_pass();
}
