/* pins - the wiring of the Uno; docs/wiring.md shows the same table. */
#ifndef PINS_H
#define PINS_H
#include <avr/io.h>

#define STROBE_PIN PB0  /* D8, ICP1: camera's exposure signal */
#define STEP_PIN PB1    /* D9, OC1A */
#define TRIGGER_PIN PB2 /* D10, OC1B */

#define ESTOP_PIN PD3   /* D3 */
#define LIMIT_PIN PD4   /* D4 */
#define LAMP_PIN PD5    /* D5, high: on */
#define ENABLE_PIN PD6  /* D6, low: driver on */
#define DIR_PIN PD7     /* D7 */

static inline void pins_init(void)
{
    PORTB = _BV(STROBE_PIN); /* pull-up */
    DDRB = _BV(STEP_PIN) | _BV(TRIGGER_PIN);
    PORTD = _BV(ESTOP_PIN) | _BV(LIMIT_PIN) | _BV(ENABLE_PIN);
    DDRD = _BV(LAMP_PIN) | _BV(ENABLE_PIN) | _BV(DIR_PIN);
}

static inline void pins_driver(uint8_t on)
{
    if (on)
        PORTD &= ~_BV(ENABLE_PIN);
    else
        PORTD |= _BV(ENABLE_PIN);
}

static inline void pins_lamp(uint8_t on)
{
    if (on)
        PORTD |= _BV(LAMP_PIN);
    else
        PORTD &= ~_BV(LAMP_PIN);
}
#endif
