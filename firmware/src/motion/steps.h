/* steps - the timer: STEP and TRIGGER edges come from its compare outputs at exact ticks, whatever else runs.
 *
 * A queue of intervals feeds the compare interrupt, which only moves data: it lowers the pin, counts the step and loads
 * the next interval. An interval that comes too late or a queue that runs dry in mid-motion is an alarm, never a late step.
 */
#ifndef STEPS_H
#define STEPS_H
#include <stdint.h>

#include "ledger.h"

#define STEPS_QUEUE 32
#define STEPS_TICKS_MAX 30000 /* longest single interval */
#define STEPS_TICKS_MIN 50

#define ENTRY_STEP 1
#define ENTRY_TRIGGER 2
#define ENTRY_LAST 4 /* the queue may run dry after this one */

void steps_init(void);
uint8_t steps_queued(void);
void steps_push(uint16_t ticks, uint8_t flags); /* the caller checked the room */
void steps_start(void);                         /* if entries wait and the timer rests */
uint8_t steps_idle(void);
void steps_kill(void);                          /* no edge after this call until unlocked; the position stays counted */
void steps_unlock(void);                        /* a new motion begins */
int32_t steps_position(void);
void steps_set_position(int32_t position);
void steps_direction(int8_t direction, uint8_t invert); /* at rest only */
void steps_pulse(uint16_t trigger_pulse_us);
void steps_segment(uint16_t segment_id);
uint8_t steps_alarm(void);                      /* ALARM_ code since the last call */
void steps_strobe_falls(uint8_t falls);
uint16_t steps_ticks(void);                     /* the timer, for short differences */
uint64_t steps_cycles(void);                    /* CPU cycles since the start */

extern struct ledger steps_ledger;              /* written by interrupts: read it atomically */
#endif
