/* clock - the emulated time against the real one: pace, freezes, and whether to go on. */
#include "bench.h"

#include <time.h>

double pace = 1;
uint64_t frozen_until_ns;
int running = 1;

uint64_t now_ns(void)
{
    struct timespec t;

    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000ull + t.tv_nsec;
}

static void sleep_until(uint64_t ns)
{
    struct timespec t = {.tv_sec = ns / 1000000000ull, .tv_nsec = ns % 1000000000ull};

    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
}

void keep_pace(avr_t *avr)
{
    static uint64_t base_ns, base_cycle;
    static double base_pace;
    uint64_t now = now_ns(), due;

    if (frozen_until_ns > now) {
        sleep_until(frozen_until_ns);
        base_pace = -1;
    }
    if (pace <= 0)
        return;
    due = base_ns + (uint64_t)((avr->cycle - base_cycle) * 62.5 / pace);
    if (base_pace != pace || now > due + 100000000ull) { /* new pace, or far behind: start counting here */
        base_ns = now;
        base_cycle = avr->cycle;
        base_pace = pace;
    } else if (due > now) {
        sleep_until(due);
    }
}
