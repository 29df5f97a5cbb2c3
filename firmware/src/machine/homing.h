/* homing - finds the limit switch and sets the zero there, or touches it again to count lost steps. */
#ifndef HOMING_H
#define HOMING_H
#include <stdint.h>

uint8_t homing_begin(uint8_t touch); /* a RESULT_ code */
void homing_poll(void);              /* call it all the time in a homing phase */

#endif
