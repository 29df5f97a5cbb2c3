#include "stack.h"

#include <avr/io.h>

#define PAINT 0xC5

extern uint8_t _end, __stack;

/* Before anything uses the stack: no prologue, no calls. */
void stack_paint(void) __attribute__((naked, used, section(".init1")));
void stack_paint(void)
{
    __asm__ volatile("    ldi r30, lo8(_end)\n"
                     "    ldi r31, hi8(_end)\n"
                     "    ldi r24, %0\n"
                     "    ldi r25, hi8(__stack)\n"
                     "1:  st Z+, r24\n"
                     "    cpi r30, lo8(__stack)\n"
                     "    cpc r31, r25\n"
                     "    brlo 1b\n" ::"M"(PAINT));
}

uint16_t stack_free_min(void)
{
    const uint8_t *p = &_end;

    while (p <= &__stack && *p == PAINT)
        p++;
    return (uint16_t)(p - &_end);
}

uint16_t stack_ram_size(void)
{
    return RAMEND - RAMSTART + 1;
}
