/* uart - bytes in and out by interrupts; realtime bytes are picked out on arrival. */
#ifndef UART_H
#define UART_H
#include <stdint.h>

#define REALTIME_HOLD 1
#define REALTIME_STOP 2
#define REALTIME_ESTOP 4

void uart_init(void);
int16_t uart_read(void);                  /* next byte or -1 */
uint8_t uart_room(void);                  /* bytes that uart_write takes */
void uart_write(const uint8_t *data, uint8_t size); /* all of it; the caller checked the room */
uint8_t uart_realtime(void);              /* REALTIME_ flags since the last call */
uint32_t uart_overruns(void);
#endif
