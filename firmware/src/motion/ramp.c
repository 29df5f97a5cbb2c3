#include "ramp.h"

#include "protocol.h"
#include "board/flash.h"

#define NO_INDEX 0xFFFF
#define SURE_MAX 60000
#define SHARED_FROM 256 /* from here on eight ramp indices share an interval: it changes by less than 2 % */
enum { WAY_LEVEL, WAY_UP, WAY_CRUISE, WAY_DOWN };

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

    return isqrt64(f * f / acceleration);
}

uint32_t ramp_rate_interval(uint16_t rate)
{
    return ((uint32_t)TICKS_PER_S * 256 + rate / 2) / rate;
}

/* Runs once per step: 16-bit shifts and three 16-bit products, about 200 cycles. */
uint32_t ramp_interval(uint32_t constant, uint16_t n)
{
    uint16_t m = 2 * n + 1;
    uint8_t shift = 1;

    if (n == 0)
        return constant + (constant >> 2) + (constant >> 3) + (constant >> 5) + (constant >> 7); /* sqrt(2) */
    if (n & 0x8000) {
        m = (n >> 1) | 0x4000; /* (2 n + 1) / 4 */
        shift = 0;
    }
    if (m < 0x0100) {
        m <<= 8;
        shift += 4;
    }
    while (m < 0x4000) {
        m <<= 2;
        shift++;
    }
    /* m = (2 n + 1) 4^shift / 4 in 14 to 16 bits; root = 2^23 / sqrt(m) = 2^24 / (sqrt(2 n + 1) 2^shift). */
    uint8_t i = (uint8_t)(m >> 8) - INDEX_MIN;
    uint16_t high = flash_u16(&inverse_root[i]);
    uint16_t low = flash_u16(&inverse_root[i + 1]);
    uint16_t root = high - (uint16_t)(((uint32_t)(uint16_t)(high - low) * (uint8_t)m) >> 8);
    uint32_t c = (uint32_t)(uint16_t)(constant >> 16) * root + (((uint32_t)(uint16_t)constant * root) >> 16);
    return c >> (8 - shift);
}

uint16_t ramp_distance(uint32_t constant, uint32_t cruise)
{
    uint64_t n = (uint64_t)constant * constant / (2 * (uint64_t)cruise * cruise);

    return n > 65000 ? 65000 : (uint16_t)n + (n < SHARED_FROM - 2 ? 2 : 10);
}

void profile_start(struct profile *p, int32_t target, uint32_t constant, uint32_t cruise)
{
    p->target = target;
    p->constant = constant;
    p->cruise = cruise;
    p->n = 0;
    p->sure = 0;
    p->interval_n = NO_INDEX;
    p->fraction = 0;
    p->cruising = 0;
    p->way = WAY_LEVEL;
    p->direction = target >= p->position ? 1 : -1;
}

static uint32_t interval_at(struct profile *p, uint16_t n)
{
    if (n >= SHARED_FROM)
        n &= ~7;
    if (n != p->interval_n) {
        p->interval_n = n;
        p->interval = ramp_interval(p->constant, n);
    }
    return p->interval;
}

/* What the steps to come do, and for how many of them that is sure. Returns 0 at the target. */
static uint8_t look_ahead(struct profile *p)
{
    int32_t away = p->target - p->position;
    uint32_t remaining = away < 0 ? -away : away, sure = 1;

    if (remaining == 0)
        return 0;
    if (remaining <= p->n) {
        p->way = WAY_DOWN;
        sure = remaining;
    } else if (p->cruising) {
        p->way = WAY_CRUISE;
        sure = remaining - p->n;
    } else if (remaining >= (uint32_t)p->n + 2) {
        p->way = WAY_UP;
        sure = (remaining - p->n) / 2;
    } else {
        p->way = WAY_LEVEL;
    }
    p->sure = sure > SURE_MAX ? SURE_MAX : (uint16_t)sure;
    return 1;
}

static uint32_t next_interval(struct profile *p)
{
    uint32_t c;

    if (p->way == WAY_CRUISE)
        return p->cruise;
    if (p->way == WAY_DOWN) {
        c = interval_at(p, --p->n);
        return c > p->cruise ? c : p->cruise;
    }
    c = interval_at(p, p->n);
    if (c <= p->cruise) {
        p->cruising = 1;
        p->sure = 0;
        return p->cruise;
    }
    if (p->way == WAY_UP)
        p->n++;
    return c;
}

uint32_t profile_next(struct profile *p)
{
    if (!p->sure && !look_ahead(p))
        return 0;
    p->sure--;
    uint32_t c = next_interval(p);
    uint16_t sum = (uint8_t)c + (uint16_t)p->fraction;
    p->fraction = (uint8_t)sum;
    p->position += p->direction;
    return (c >> 8) + (sum >> 8);
}

void profile_halt(struct profile *p)
{
    /* At least one step more: the step before may be queued already as one that has a successor. */
    int32_t rest = p->position + (int32_t)p->direction * (p->n ? p->n : 1);

    if ((p->target - rest) * p->direction > 0) {
        p->target = rest;
        p->sure = 0;
    }
}
