/* debounce - a switch sampled once per millisecond: its settled level, and where the stage was at the first contact. Pure. */
#ifndef DEBOUNCE_H
#define DEBOUNCE_H
#include <stdint.h>

struct debounce {
    uint8_t settled;     /* the level that has lasted */
    uint8_t count;       /* samples of the other level in a row */
    uint8_t needed;
    int32_t edge;        /* position at the first sample of that row */
};

/* One sample; returns 1 when the settled level has just changed. */
uint8_t debounce_sample(struct debounce *d, uint8_t level, int32_t position);
#endif
