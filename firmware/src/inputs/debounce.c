#include "debounce.h"

uint8_t debounce_sample(struct debounce *d, uint8_t level, int32_t position)
{
    if (level == d->settled) {
        d->count = 0;
        return 0;
    }
    if (d->count++ == 0)
        d->edge = position;
    if (d->count < d->needed)
        return 0;
    d->settled = level;
    d->count = 0;
    return 1;
}
