#include <errno.h>
#include <fcntl.h>
#include <pty.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

#include "avr_uart.h"
#include "bench.h"

#define IN_SIZE 4096

struct line line = {.seed = 1};

static avr_t *avr;
static avr_irq_t *uart_in;
static int master = -1, slave = -1, ready;
static char name[64], stable[256];
static uint8_t waiting[IN_SIZE];
static int waiting_size;
static uint64_t random_state = 88172645463325252ull;

static double random_share(void)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (double)(random_state >> 11) / 9007199254740992.0;
}

void line_seed(uint64_t seed)
{
    line.seed = seed;
    random_state = seed * 0x9E3779B97F4A7C15ull + 1;
    for (int i = 0; i < 8; i++)
        random_share();
    srand((unsigned)seed);
}

/* What arrives of one byte: flipped, preceded by another, lost, or doubled with the probability of the knob. */
static int hurt(uint8_t byte, uint8_t out[2])
{
    out[0] = out[1] = byte;
    if (line.noise <= 0 || random_share() >= line.noise)
        return 1;
    line.hurt++;
    switch ((int)(random_share() * 4)) {
    case 0:
        out[0] = byte ^ (1 << (int)(random_share() * 8));
        return 1;
    case 1:
        out[0] = (uint8_t)(random_share() * 256);
        return 2;
    case 2:
        return 0;
    default:
        return 2;
    }
}

static void on_output(struct avr_irq_t *irq, uint32_t value, void *param)
{
    uint8_t bytes[2];
    int n = hurt((uint8_t)value, bytes);

    line.bytes_out++;
    if (master >= 0 && n && write(master, bytes, n) < 0 && errno != EAGAIN)
        line_unplug();
}

static void on_xon(struct avr_irq_t *irq, uint32_t value, void *param)
{
    ready = 1;
}

static void on_xoff(struct avr_irq_t *irq, uint32_t value, void *param)
{
    ready = 0;
}

int line_plug(void)
{
    struct termios raw;

    if (master >= 0)
        return 0;
    if (openpty(&master, &slave, name, NULL, NULL) < 0)
        return -1;
    tcgetattr(slave, &raw);
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw);
    fcntl(master, F_SETFL, O_NONBLOCK);
    waiting_size = 0;
    if (stable[0]) {
        unlink(stable);
        if (symlink(name, stable) < 0)
            return -1;
    }
    return 0;
}

void line_unplug(void)
{
    if (master < 0)
        return;
    close(master);
    close(slave);
    master = slave = -1;
    if (stable[0])
        unlink(stable);
}

const char *line_name(void)
{
    return stable[0] ? stable : name;
}

int line_init(avr_t *the_avr, const char *link_path)
{
    uint32_t flags = 0;

    avr = the_avr;
    if (link_path)
        snprintf(stable, sizeof stable, "%s", link_path);
    avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
    flags &= ~(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    uart_in = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_output, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XON), on_xon, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XOFF), on_xoff, NULL);
    line_seed(line.seed);
    return line_plug();
}

static void receive(void)
{
    uint8_t bytes[1024], out[2];
    ssize_t got;

    if (master < 0 || waiting_size > IN_SIZE - 2 * (int)sizeof bytes)
        return;
    got = read(master, bytes, sizeof bytes);
    for (ssize_t i = 0; i < got; i++) {
        int n = hurt(bytes[i], out);
        memcpy(waiting + waiting_size, out, n);
        waiting_size += n;
        line.bytes_in++;
    }
}

void line_poll(void)
{
    int used = 0;

    receive();
    while (ready && used < waiting_size)
        avr_raise_irq(uart_in, waiting[used++]);
    if (used) {
        memmove(waiting, waiting + used, waiting_size - used);
        waiting_size -= used;
    }
}
