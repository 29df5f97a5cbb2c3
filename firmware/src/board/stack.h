/* stack - how much RAM between the variables and the stack was never touched. */
#ifndef STACK_H
#define STACK_H
#include <stdint.h>

uint16_t stack_free_min(void);
uint16_t stack_ram_size(void);
#endif
