/* ramp - how long each step of an acceleration lasts, and the profile of one move. Pure integers.
 *
 * A ramp index n counts the steps of acceleration that would lead to the present speed; the interval of step n depends
 * on n alone, so braking retraces acceleration and n is the distance needed to stop.
 */
#ifndef RAMP_H
#define RAMP_H
#include <stdint.h>

/* Interval constant: ramp_interval(k, n) is k / sqrt(2 n + 1), k = f / sqrt(a) in 1/256 ticks. */
uint32_t ramp_constant(uint32_t acceleration);

/* Interval in 1/256 ticks between two steps at rate steps per second. */
uint32_t ramp_rate_interval(uint16_t rate);

/* Interval in 1/256 ticks of acceleration step n (0 is the first from rest). */
uint32_t ramp_interval(uint32_t constant, uint16_t n);

/* Steps of acceleration from rest to a cruise interval. */
uint16_t ramp_distance(uint32_t constant, uint32_t cruise);

struct profile {
    int32_t position, target;
    uint32_t constant, cruise; /* 1/256 ticks */
    uint32_t interval;         /* of ramp index interval_n, kept because neighbours share it at high speed */
    uint16_t interval_n;
    uint16_t n;
    uint16_t sure;             /* steps to come that need no look at the target */
    uint8_t way;               /* how those steps go */
    uint8_t fraction;          /* 1/256 ticks carried over */
    int8_t direction;
    uint8_t cruising;          /* the last step had the cruise interval */
};

/* Set out from rest. */
void profile_start(struct profile *p, int32_t target, uint32_t constant, uint32_t cruise);

/* Ticks until the next step, or 0 at the target; position already includes the step. */
uint32_t profile_next(struct profile *p);

/* Brake: the target becomes the place where it comes to rest. */
void profile_halt(struct profile *p);

uint32_t isqrt64(uint64_t x);
#endif
