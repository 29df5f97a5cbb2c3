/* main - start, watchdog and the loop. Nothing here waits. */
#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/wdt.h>
#include <stdint.h>

#include "board/pins.h"
#include "inputs/clock.h"
#include "link/link.h"
#include "link/uart.h"
#include "machine/machine.h"
#include "machine/poll.h"
#include "motion/steps.h"

#define BOOT_SLOTS 16 /* the counter moves over these cells, so that each wears 16 times slower */

static uint8_t reset_cause __attribute__((section(".noinit")));
static uint32_t EEMEM boots[BOOT_SLOTS];

/* The watchdog stays on after it bit, with its shortest time: off before anything else. */
void keep_cause(void) __attribute__((naked, used, section(".init3")));
void keep_cause(void)
{
    reset_cause = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

static uint32_t count_boot(void)
{
    uint32_t newest = 0;

    for (uint8_t i = 0; i < BOOT_SLOTS; i++) {
        uint32_t n = eeprom_read_dword(&boots[i]);
        if (n != 0xFFFFFFFF && n > newest)
            newest = n;
    }
    newest++;
    eeprom_write_dword(&boots[newest % BOOT_SLOTS], newest);
    return newest;
}

int main(void)
{
    pins_init();
    uint32_t boot_id = count_boot();
    uart_init();
    clock_init();
    steps_init();
    machine_init(boot_id);
    link_init(boot_id, reset_cause);
    wdt_enable(WDTO_120MS);
    sei();
    for (;;) {
        uint16_t begin = steps_ticks();
        wdt_reset();
        link_poll();
        machine_poll();
        link_loop_time((uint16_t)(steps_ticks() - begin) / (TICKS_PER_S / 1000000));
    }
}
