#include "ramp.h"

#include "../protocol.h"
#include "flash.h"

#define INDEX_MIN 64
#define INDEX_MAX 256

/* round(2^19 / sqrt(i)) - 1 for i = 64..256: the host test recomputes them. */
static const uint16_t inverse_root[INDEX_MAX - INDEX_MIN + 1] IN_FLASH = {
#include "inverse_root.inc"
};

uint32_t isqrt64(uint64_t x)
{
    uint64_t root = 0, bit = 1ULL << 62;

    while (bit > x)
        bit >>= 2;
    while (bit) {
        if (x >= root + bit) {
            x -= root + bit;
            root = (root >> 1) + bit;
        } else {
            root >>= 1;
        }
        bit >>= 2;
    }
    return (uint32_t)root;
}

uint32_t ramp_constant(uint32_t acceleration)
{
    uint64_t f = (uint64_t)TICKS_PER_S * 256;

    return isqrt64(f * f / (2 * (uint64_t)acceleration));
}

uint32_t ramp_rate_interval(uint16_t rate)
{
    return ((uint32_t)TICKS_PER_S * 256 + rate / 2) / rate;
}

uint32_t ramp_interval(uint32_t constant, uint16_t n)
{
    /* 1 / sqrt(n + 1/2) = sqrt(2) / sqrt(2 n + 1); m = 2 n + 1 is brought to 16..18 bits by powers of four. */
    uint32_t m = 2 * (uint32_t)n + 1;
    uint8_t shift = 0;

    if (n == 0)
        return constant * 2; /* the first step from rest: sqrt(2 / a) exactly */
    while (m < (1UL << 16)) {
        m <<= 2;
        shift++;
    }
    uint8_t i = (uint8_t)(m >> 10) - INDEX_MIN;
    uint16_t high = flash_u16(&inverse_root[i]);
    uint16_t low = flash_u16(&inverse_root[i + 1]);
    uint16_t root = high - (uint16_t)(((uint32_t)(high - low) * (uint16_t)(m & 1023)) >> 10);
    /* root = 2^19 / sqrt(m / 1024) = 2^24 / sqrt(m), and m = (2 n + 1) 4^shift. */
    uint32_t c = (constant >> 16) * root + (((constant & 0xFFFF) * (uint32_t)root) >> 16);
    /* c = constant root / 2^16 = constant 2^8 / (sqrt(2 n + 1) 2^shift); times sqrt(2) = 362.04 / 256. */
    c = (uint32_t)(((c >> 8) * 362) + (((c & 255) * 362) >> 8));
    return shift >= 8 ? c << (shift - 8) : c >> (8 - shift);
}

uint16_t ramp_distance(uint32_t constant, uint32_t cruise)
{
    uint64_t n = (uint64_t)constant * constant / ((uint64_t)cruise * cruise);

    return n > 65000 ? 65000 : (uint16_t)n + 2;
}

void profile_start(struct profile *p, int32_t target, uint32_t constant, uint32_t cruise)
{
    p->target = target;
    p->constant = constant;
    p->cruise = cruise;
    p->n = 0;
    p->fraction = 0;
    p->cruising = 0;
    p->direction = target >= p->position ? 1 : -1;
}

static uint32_t next_interval(struct profile *p, uint32_t remaining)
{
    if (remaining <= p->n) {
        p->n--;
        uint32_t c = ramp_interval(p->constant, p->n);
        return c > p->cruise ? c : p->cruise;
    }
    if (p->cruising)
        return p->cruise;
    uint32_t c = ramp_interval(p->constant, p->n);
    if (c <= p->cruise) {
        p->cruising = 1;
        return p->cruise;
    }
    if (remaining >= (uint32_t)p->n + 2)
        p->n++;
    return c;
}

uint32_t profile_next(struct profile *p)
{
    int32_t away = p->target - p->position;
    uint32_t remaining = away < 0 ? -away : away;

    if (remaining == 0)
        return 0;
    uint32_t c = next_interval(p, remaining) + p->fraction;
    p->fraction = c & 255;
    p->position += p->direction;
    return c >> 8;
}

void profile_halt(struct profile *p)
{
    /* At least one step more: the step before may be queued already as one that has a successor. */
    int32_t rest = p->position + (int32_t)p->direction * (p->n ? p->n : 1);

    if ((p->target - rest) * p->direction > 0)
        p->target = rest;
}
