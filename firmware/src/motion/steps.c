#include "steps.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "board/pins.h"

#define MARGIN 10 /* ticks that a compare value must lie ahead */

#define COM_A (_BV(COM1A1) | _BV(COM1A0))
#define COM_B (_BV(COM1B1) | _BV(COM1B0))

struct ledger steps_ledger;

static volatile struct { uint16_t ticks; uint8_t flags; } queue[STEPS_QUEUE];
static volatile uint8_t head, tail;
static volatile uint8_t running, entry, alarm, locked;
static volatile int32_t position;
static volatile uint32_t overflows;
static volatile int8_t direction = 1;
static uint16_t due;            /* tick of the running entry */
static uint16_t pulse = 200;    /* ticks that TRIGGER stays high */
static volatile uint16_t segment;

enum { TRIGGER_REST, TRIGGER_ARMED, TRIGGER_HIGH };
static volatile uint8_t trigger_state, trigger_waits;
static uint16_t trigger_due, waiting_due;
static int32_t trigger_position, waiting_position;

void steps_init(void)
{
    ledger_init(&steps_ledger);
    TCCR1A = _BV(COM1A1) | _BV(COM1B1); /* both latches low, whatever they were */
    TCCR1C = _BV(FOC1A) | _BV(FOC1B);
    TCCR1A = 0;
    TCCR1B = _BV(CS11) | _BV(ICNC1) | _BV(ICES1); /* 2 MHz, free running */
    TIFR1 = 0xFF;
    TIMSK1 = _BV(TOIE1) | _BV(ICIE1);
}

/* Clears the flag of a match. An overflow that waits for its interrupt is counted here and cleared along: simavr 1.6 drops
 * it whenever any flag of the timer is cleared, and all later time stamps would be early by one overflow. */
static inline void clear_match(uint8_t flag)
{
    if (TIFR1 & _BV(TOV1)) {
        overflows++;
        flag |= _BV(TOV1);
    }
    TIFR1 = flag;
}

/* After a match the compare latch is high and must be low again before it is connected for the next edge. A forced match
 * in toggle mode does that; then the pin is disconnected and shows its port bit, which is 0. (A forced match in clear mode
 * would do too, but simavr 1.6 moves a pin in clear mode at every write to a compare register.) */
static inline void step_low(void)
{
    TCCR1A = (TCCR1A & ~COM_A) | _BV(COM1A0);
    TCCR1C = _BV(FOC1A);
    TCCR1A &= ~COM_A;
}

/* TRIGGER is held high by its port bit while other edges pass; the latch goes first, so that there is one falling edge. */
static inline void trigger_low(void)
{
    TCCR1A = (TCCR1A & ~COM_B) | _BV(COM1B0);
    TCCR1C = _BV(FOC1B);
    PORTB &= ~_BV(TRIGGER_PIN);
    TCCR1A &= ~COM_B;
    TIMSK1 &= ~_BV(OCIE1B);
    trigger_state = TRIGGER_REST;
}

static inline void finish_entry(void)
{
    if (entry & ENTRY_STEP) {
        step_low();
        position += direction;
    }
}

/* The time stamp's high part for a tick value that is at most one overflow old. */
static uint32_t high_part(uint16_t at)
{
    uint16_t now = TCNT1;
    uint32_t high = overflows;

    if ((TIFR1 & _BV(TOV1)) && now < 0x8000)
        high++;
    return at > now ? high - 1 : high;
}

static void trigger_rose(void)
{
    ledger_fire(&steps_ledger, trigger_position, high_part(trigger_due), trigger_due, segment);
    uint16_t fall = trigger_due + pulse;
    PORTB |= _BV(TRIGGER_PIN);
    TCCR1A &= ~COM_B; /* the port holds it high from here */
    OCR1B = fall;
    clear_match(_BV(OCF1B));
    trigger_state = TRIGGER_HIGH;
    if ((int16_t)(fall - TCNT1) < MARGIN / 2)
        trigger_low();
}

/* Nothing moves after this: edges that are out already are counted, those still to come are taken back. */
static void stop_outputs(void)
{
    TIMSK1 &= ~_BV(OCIE1A);
    if (running && (TIFR1 & _BV(OCF1A)))
        finish_entry();
    TCCR1A &= ~COM_A;
    running = 0;
    tail = head;
    trigger_waits = 0;
    if (trigger_state != TRIGGER_ARMED)
        return;
    if (TIFR1 & _BV(OCF1B)) {
        trigger_rose();
    } else {
        TCCR1A &= ~COM_B;
        TIMSK1 &= ~_BV(OCIE1B);
        trigger_state = TRIGGER_REST;
    }
}

static void fail(uint8_t code)
{
    stop_outputs();
    alarm = code;
}

static void arm_trigger(uint16_t at, int32_t where)
{
    trigger_due = at;
    trigger_position = where;
    OCR1B = at;
    clear_match(_BV(OCF1B));
    TCCR1A |= COM_B;
    TIMSK1 |= _BV(OCIE1B);
    trigger_state = TRIGGER_ARMED;
    if ((int16_t)(at - TCNT1) < MARGIN / 2)
        fail(ALARM_TRIGGER_OVERRUN);
}

static void next_trigger(uint16_t at, int32_t where)
{
    if (trigger_state == TRIGGER_REST) {
        arm_trigger(at, where);
    } else if (trigger_waits) {
        fail(ALARM_TRIGGER_OVERRUN);
    } else {
        trigger_waits = 1;
        waiting_due = at;
        waiting_position = where;
    }
}

ISR(TIMER1_COMPA_vect)
{
    finish_entry();
    if (head == tail) {
        if (!(entry & ENTRY_LAST))
            alarm = ALARM_UNDERRUN;
        TIMSK1 &= ~_BV(OCIE1A);
        running = 0;
        return;
    }
    uint8_t flags = entry = queue[tail].flags;
    due += queue[tail].ticks;
    tail = (tail + 1) & (STEPS_QUEUE - 1);
    OCR1A = due;
    if (flags & ENTRY_STEP)
        TCCR1A |= COM_A;
    if ((int16_t)(due - TCNT1) < MARGIN) {
        fail(ALARM_LATE_STEP);
        return;
    }
    if (flags & ENTRY_TRIGGER)
        next_trigger(due, flags & ENTRY_STEP ? position + direction : position);
}

ISR(TIMER1_COMPB_vect)
{
    if (trigger_state == TRIGGER_ARMED)
        trigger_rose();
    else
        trigger_low();
    if (trigger_state == TRIGGER_REST && trigger_waits) {
        trigger_waits = 0;
        arm_trigger(waiting_due, waiting_position);
    }
}

ISR(TIMER1_OVF_vect)
{
    overflows++;
}

ISR(TIMER1_CAPT_vect)
{
    uint16_t at = ICR1;

    ledger_strobe(&steps_ledger, high_part(at), at);
}

uint8_t steps_queued(void)
{
    return (head - tail) & (STEPS_QUEUE - 1);
}

void steps_push(uint16_t ticks, uint8_t flags)
{
    queue[head].ticks = ticks;
    queue[head].flags = flags;
    head = (head + 1) & (STEPS_QUEUE - 1);
}

void steps_start(void)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        if (!running && !locked && head != tail) {
            running = 1;
            entry = 0;
            due = TCNT1 + 4 * MARGIN;
            OCR1A = due;
            clear_match(_BV(OCF1A));
            TIMSK1 |= _BV(OCIE1A);
        }
    }
}

void steps_unlock(void)
{
    locked = 0;
}

uint8_t steps_idle(void)
{
    return !running && head == tail && trigger_state == TRIGGER_REST;
}

void steps_kill(void)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        locked = 1;
        stop_outputs();
    }
}

int32_t steps_position(void)
{
    int32_t p;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        p = position;
    }
    return p;
}

void steps_set_position(int32_t p)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        position = p;
    }
}

void steps_direction(int8_t d, uint8_t invert)
{
    direction = d;
    if ((d > 0) != (invert != 0))
        PORTD |= _BV(DIR_PIN);
    else
        PORTD &= ~_BV(DIR_PIN);
}

void steps_pulse(uint16_t trigger_pulse_us)
{
    pulse = trigger_pulse_us * (TICKS_PER_S / 1000000);
}

void steps_segment(uint16_t segment_id)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        segment = segment_id;
    }
}

uint8_t steps_alarm(void)
{
    uint8_t code;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        code = alarm;
        alarm = ALARM_NONE;
    }
    return code;
}

void steps_strobe_falls(uint8_t falls)
{
    if (falls)
        TCCR1B &= ~_BV(ICES1);
    else
        TCCR1B |= _BV(ICES1);
}

uint16_t steps_ticks(void)
{
    uint16_t now;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) /* its two bytes pass through a register that interrupts use too */
    {
        now = TCNT1;
    }
    return now;
}

uint64_t steps_cycles(void)
{
    uint32_t high;
    uint16_t low;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        low = TCNT1;
        high = overflows;
        if ((TIFR1 & _BV(TOV1)) && low < 0x8000)
            high++;
    }
    return ((uint64_t)high << 16 | low) * CYCLES_PER_TICK;
}
