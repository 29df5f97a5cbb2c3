#include "uart.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "protocol.h"

#define RX_SIZE 128 /* powers of two; takes WINDOW_MAX blocks of ordinary commands */
#define TX_SIZE 128 /* the longest report, and an answer */

static volatile uint8_t rx[RX_SIZE], rx_head, rx_tail;
static volatile uint8_t tx[TX_SIZE], tx_head, tx_tail;
static volatile uint8_t realtime;
static volatile uint16_t overruns;

enum { BETWEEN, IN_BLOCK, SAW_STOP, SAW_ESTOP };
static uint8_t place = IN_BLOCK; /* only the receive interrupt uses it */

void uart_init(void)
{
    UCSR0A = _BV(U2X0); /* before the divisor: simavr takes the rate when that is written */
    UBRR0 = F_CPU / 8 / LINK_BAUD - 1;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

static void rx_put(uint8_t byte)
{
    uint8_t next = (rx_head + 1) & (RX_SIZE - 1);

    if (next == rx_tail) {
        overruns++;
        return;
    }
    rx[rx_head] = byte;
    rx_head = next;
}

/* Returns 1 if the byte was a realtime byte, or the beginning of one, and is no part of a block. */
static uint8_t take_realtime(uint8_t byte)
{
    switch (place) {
    case BETWEEN:
        if (byte == RT_HOLD) {
            realtime |= REALTIME_HOLD;
            return 1;
        }
        place = byte == RT_STOP ? SAW_STOP : byte == RT_ESTOP ? SAW_ESTOP : IN_BLOCK;
        return place != IN_BLOCK;
    case SAW_STOP:
    case SAW_ESTOP:
        if (place == SAW_STOP && byte == RT_STOP_CONFIRM)
            realtime |= REALTIME_STOP;
        else if (place == SAW_ESTOP && byte == RT_ESTOP_CONFIRM)
            realtime |= REALTIME_ESTOP;
        else {
            place = IN_BLOCK;
            return 0; /* noise; the block's CRC will say so */
        }
        place = BETWEEN;
        return 1;
    default:
        return 0;
    }
}

ISR(USART_RX_vect)
{
    uint8_t status = UCSR0A, byte = UDR0;

    if (status & (_BV(DOR0) | _BV(FE0)))
        overruns++;
    if (byte == 0)
        place = BETWEEN;
    else if (take_realtime(byte))
        return;
    rx_put(byte);
}

ISR(USART_UDRE_vect)
{
    if (tx_head == tx_tail) {
        UCSR0B &= ~_BV(UDRIE0);
        return;
    }
    UDR0 = tx[tx_tail];
    tx_tail = (tx_tail + 1) & (TX_SIZE - 1);
}

int16_t uart_read(void)
{
    if (rx_head == rx_tail)
        return -1;
    uint8_t byte = rx[rx_tail];
    rx_tail = (rx_tail + 1) & (RX_SIZE - 1);
    return byte;
}

uint8_t uart_room(void)
{
    return (tx_tail - tx_head - 1) & (TX_SIZE - 1);
}

void uart_write(const uint8_t *data, uint8_t size)
{
    while (size--) {
        tx[tx_head] = *data++;
        tx_head = (tx_head + 1) & (TX_SIZE - 1);
    }
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        UCSR0B |= _BV(UDRIE0);
    }
}

uint8_t uart_realtime(void)
{
    uint8_t flags;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        flags = realtime;
        realtime = 0;
    }
    return flags;
}

uint32_t uart_overruns(void)
{
    uint16_t n;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        n = overruns;
    }
    return n;
}
