/* clock - the millisecond tick, and the two switches sampled on it. */
#ifndef CLOCK_H
#define CLOCK_H
#include <stdint.h>

void clock_init(void);
uint32_t clock_ms(void);
void clock_switches(uint8_t limit_closes, uint8_t estop_closes, uint8_t limit_fitted);
uint8_t clock_limit(void);        /* pressed, settled */
uint8_t clock_limit_raw(void);    /* any contact not yet settled as released */
uint8_t clock_estop(void);        /* pressed, settled; sticky while pressed */
void clock_watch_contact(void);   /* from now on latch the position at the first contact */
uint8_t clock_contact(int32_t *position); /* 1 and the position if there was one */
#endif
