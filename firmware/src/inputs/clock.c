#include "clock.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "debounce.h"
#include "board/pins.h"
#include "motion/steps.h"

#define LIMIT_SAMPLES 5 /* ms: longer than a lever switch bounces */
#define ESTOP_SAMPLES 2

static volatile uint32_t ms;
static struct debounce limit = {.needed = LIMIT_SAMPLES}, estop = {.needed = ESTOP_SAMPLES};
static volatile uint8_t limit_fitted = 1, active_low; /* bits of pins that are pressed when low */
static volatile uint8_t watching, contact;
static volatile int32_t contact_position;

void clock_init(void)
{
    TCCR0A = _BV(WGM01);
    OCR0A = F_CPU / 64 / 1000 - 1;
    TCCR0B = _BV(CS01) | _BV(CS00);
    TIMSK0 = _BV(OCIE0A);
}

ISR(TIMER0_COMPA_vect)
{
    uint8_t pressed = PIND ^ active_low;

    ms++;
    if (debounce_sample(&estop, (pressed & _BV(ESTOP_PIN)) != 0, 0) && estop.settled)
        steps_kill();
    if (!limit_fitted)
        return;
    debounce_sample(&limit, (pressed & _BV(LIMIT_PIN)) != 0, 0);
    if (watching && (pressed & _BV(LIMIT_PIN))) {
        watching = 0;
        contact = 1;
        contact_position = steps_position();
    }
}

uint32_t clock_ms(void)
{
    uint32_t now;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        now = ms;
    }
    return now;
}

void clock_switches(uint8_t limit_closes, uint8_t estop_closes, uint8_t fitted)
{
    active_low = (limit_closes ? _BV(LIMIT_PIN) : 0) | (estop_closes ? _BV(ESTOP_PIN) : 0);
    limit_fitted = fitted;
}

uint8_t clock_limit(void)
{
    return limit_fitted && limit.settled;
}

uint8_t clock_limit_raw(void)
{
    return limit_fitted && (limit.settled || limit.count);
}

uint8_t clock_estop(void)
{
    return estop.settled;
}

void clock_watch_contact(void)
{
    contact = 0;
    watching = 1;
}

uint8_t clock_contact(int32_t *position)
{
    if (!contact)
        return 0;
    *position = contact_position; /* latched once: no longer written */
    return 1;
}
