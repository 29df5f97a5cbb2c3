/* link - the serial protocol: valid blocks become commands, each carried out once; answers and reports are sent. */
#ifndef LINK_H
#define LINK_H
#include <stdint.h>

void link_init(uint32_t boot_id, uint8_t reset_cause);
void link_poll(void);
void link_loop_time(uint16_t us); /* for the diagnosis */
#endif
