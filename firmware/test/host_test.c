/* host_test - the pure parts, compiled for this machine with the sanitizers on. Prints what failed; exit status 1. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "protocol.h"
#include "inputs/debounce.h"
#include "link/frame.h"
#include "motion/ledger.h"
#include "motion/ramp.h"
#include "link/window.h"

static int failures;
static const char *current;

#define CHECK(condition)                                                                              \
    do {                                                                                              \
        if (!(condition)) {                                                                           \
            failures++;                                                                               \
            printf("%s: line %d: %s\n", current, __LINE__, #condition);                               \
        }                                                                                             \
    } while (0)

static void crc_is_zlibs(void)
{
    const char *text = "123456789";

    CHECK(frame_crc32(0, (const uint8_t *)text, 9) == 0xCBF43926);
    CHECK(frame_crc32(frame_crc32(0, (const uint8_t *)text, 4), (const uint8_t *)text + 4, 5) == 0xCBF43926);
}

static uint8_t make_block(uint8_t *encoded, uint8_t body)
{
    uint8_t raw[BODY_MAX + BLOCK_OVERHEAD] = {body, 7, CMD_MOVE};

    for (uint8_t i = 0; i < body; i++)
        raw[3 + i] = (uint8_t)(rand() % 4);
    return frame_cobs_encode(raw, frame_close(raw), encoded);
}

static void every_block_comes_back(void)
{
    uint8_t encoded[BODY_MAX + BLOCK_OVERHEAD + 1];

    for (int body = 0; body <= BODY_MAX; body++) {
        uint8_t size = make_block(encoded, (uint8_t)body);
        CHECK(memchr(encoded, 0, size) == NULL);
        CHECK(encoded[0] < 0x80); /* cannot be taken for a realtime byte */
        CHECK(frame_open(encoded, size));
        CHECK(encoded[0] == body && encoded[1] == 7 && encoded[2] == CMD_MOVE);
    }
}

static void no_single_damage_gets_through(void)
{
    uint8_t encoded[BODY_MAX + BLOCK_OVERHEAD + 1], hurt[sizeof encoded];

    for (int round = 0; round < 2000; round++) {
        uint8_t size = make_block(encoded, (uint8_t)(rand() % COMMAND_BODY_MAX));
        uint8_t at = (uint8_t)(rand() % size);
        memcpy(hurt, encoded, size);
        hurt[at] ^= (uint8_t)(1 << rand() % 8);
        CHECK(!frame_open(hurt, size));
        memmove(hurt, encoded, at);
        memmove(hurt + at, encoded + at + 1, size - at - 1);
        CHECK(!frame_open(hurt, (uint8_t)(size - 1)));
    }
}

static void noise_is_refused_within_bounds(void)
{
    uint8_t noise[64];

    for (int round = 0; round < 20000; round++) {
        uint8_t size = (uint8_t)(rand() % sizeof noise);
        for (uint8_t i = 0; i < size; i++)
            noise[i] = (uint8_t)(rand() % 256);
        CHECK(!frame_open(noise, size));
    }
}

static void intervals_follow_the_square_root(void)
{
    static const uint32_t accelerations[] = {100, 20000, 100000, 1000000};

    for (unsigned a = 0; a < 4; a++) {
        uint32_t k = ramp_constant(accelerations[a]);
        double exact_k = 256.0 * TICKS_PER_S / sqrt(accelerations[a]);
        CHECK(fabs(k - exact_k) < 2);
        CHECK(fabs(ramp_interval(k, 0) - exact_k * sqrt(2)) < exact_k * 2e-3);
        for (uint32_t n = 1; n < 65535; n = n * 9 / 8 + 1) {
            double exact = exact_k / sqrt(2.0 * n + 1);
            CHECK(fabs(ramp_interval(k, (uint16_t)n) - exact) < exact * 3e-4 + 2);
        }
    }
}

struct run {
    long steps;
    double seconds, fastest_seconds;
    int ordered;
};

static struct run run_move(int32_t from, int32_t to, uint32_t acceleration, uint16_t rate, int32_t halt_after)
{
    struct profile p = {.position = from};
    struct run r = {.fastest_seconds = 1e9, .ordered = 1};
    uint32_t ticks, before = UINT32_MAX - 1;
    int braking = 0;

    profile_start(&p, to, ramp_constant(acceleration), ramp_rate_interval(rate));
    while ((ticks = profile_next(&p)) && r.steps < 1000000) {
        double seconds = (double)ticks / TICKS_PER_S;
        r.steps++;
        r.seconds += seconds;
        if (seconds < r.fastest_seconds)
            r.fastest_seconds = seconds;
        if (ticks > before + 1)
            braking = 1;
        else if (braking && ticks + 1 < before)
            r.ordered = 0; /* faster again after it had begun to brake */
        before = ticks;
        if (r.steps == halt_after)
            profile_halt(&p);
    }
    r.ordered = r.ordered && p.position == (halt_after ? p.target : to);
    return r;
}

static void moves_end_where_they_must(void)
{
    for (int32_t distance = 1; distance < 3000; distance = distance * 5 / 4 + 1) {
        CHECK(run_move(-7, -7 + distance, 20000, 2000, 0).steps == distance);
        CHECK(run_move(11, 11 - distance, 20000, 2000, 0).steps == distance);
        CHECK(run_move(0, distance, 100000, 20000, 0).ordered);
    }
}

static void moves_keep_speed_and_take_the_time_of_a_trapezoid(void)
{
    struct run r = run_move(0, 20000, 100000, 20000, 0);

    CHECK(r.fastest_seconds >= 1.0 / 20000 - 1.0 / TICKS_PER_S);
    CHECK(fabs(r.seconds - (20000.0 / 20000 + 20000.0 / 100000)) < 0.01);
}

static void a_halt_stops_within_the_braking_distance(void)
{
    uint32_t k = ramp_constant(20000);

    for (int32_t at = 1; at < 400; at += 7) {
        struct run r = run_move(0, 100000, 20000, 2000, at);
        CHECK(r.ordered);
        CHECK(r.steps > at && r.steps <= at + ramp_distance(k, ramp_rate_interval(2000)) + 1);
    }
}

static void the_run_up_reaches_the_speed(void)
{
    for (uint16_t rate = 1; rate < 20000; rate = (uint16_t)(rate * 3 / 2 + 1)) {
        struct profile p = {0};
        uint32_t k = ramp_constant(20000), cruise = ramp_rate_interval(rate);
        uint16_t run_up = ramp_distance(k, cruise);
        profile_start(&p, 1000000, k, cruise);
        for (uint16_t i = 0; i < run_up; i++)
            profile_next(&p);
        CHECK(p.cruising);
    }
}

static void credit_is_absolute_and_never_shrinks(void)
{
    struct ledger l;

    ledger_init(&l);
    CHECK(!ledger_may(&l, 0));
    ledger_grant(&l, 2);
    ledger_grant(&l, 1);
    CHECK(ledger_may(&l, 2) && !ledger_may(&l, 3));
    CHECK(ledger_credit(&l, 0, 10) == 3 && ledger_credit(&l, 3, 10) == 0);
}

static void events_that_the_host_has_not_seen_are_never_pushed_out(void)
{
    struct ledger l;

    ledger_init(&l);
    ledger_grant(&l, 1000);
    for (uint32_t id = 0; ledger_may(&l, id); id++)
        ledger_fire(&l, (int32_t)id * 3, 0, (uint16_t)id, 1);
    CHECK(l.fired == EVENT_MEMORY);
    for (uint32_t id = 0; id < EVENT_MEMORY; id++)
        CHECK(ledger_event(&l, id) && ledger_event(&l, id)->position == (int32_t)id * 3);
    CHECK(ledger_seen(&l, 5) && ledger_may(&l, EVENT_MEMORY + 4) && !ledger_may(&l, EVENT_MEMORY + 5));
    CHECK(!ledger_seen(&l, EVENT_MEMORY + 1)); /* has not fired */
    CHECK(!ledger_event(&l, EVENT_MEMORY));
}

static void strobes_are_timed_against_their_trigger(void)
{
    struct ledger l;

    ledger_init(&l);
    ledger_strobe(&l, 0, 5); /* before any trigger: counted, no more */
    ledger_fire(&l, 0, 4, 0xFFF0, 1);
    ledger_strobe(&l, 5, 0x0010);
    ledger_strobe(&l, 5, 0x0900); /* a second one does not change it */
    CHECK(l.strobes == 3 && ledger_event(&l, 0)->strobe_delay == 0x20);
}

static void commands_run_once_and_in_order(void)
{
    struct window w = {0};

    CHECK(window_judge(&w, 0) == WINDOW_NO_SESSION);
    window_open(&w, 99);
    for (int i = 0; i < 1000; i++) {
        uint8_t sequence = (uint8_t)i;
        CHECK(window_judge(&w, sequence) == WINDOW_RUN);
        CHECK(window_judge(&w, (uint8_t)(sequence + 1)) == WINDOW_GAP);
        window_done(&w, (uint8_t)(i % 5));
        for (int age = 0; age < RESULT_MEMORY && age <= i; age++) {
            CHECK(window_judge(&w, (uint8_t)(sequence - age)) == WINDOW_REPEAT);
            CHECK(window_result(&w, (uint8_t)(sequence - age)) == (i - age) % 5);
        }
        window_open(&w, 99); /* a repeated hello changes nothing */
    }
    CHECK(w.run == 1000);
    window_open(&w, 100);
    CHECK(window_judge(&w, 0) == WINDOW_RUN && window_judge(&w, 255) == WINDOW_GAP);
}

static void bouncing_contacts_settle_once_at_their_first_touch(void)
{
    struct debounce d = {.needed = 5};
    static const uint8_t samples[] = {1, 0, 1, 1, 0, 1, 1, 1, 1, 1, 1, 1};
    int changes = 0, when = -1;

    for (int i = 0; i < 12; i++)
        if (debounce_sample(&d, samples[i], i)) {
            changes++;
            when = i;
        }
    CHECK(changes == 1 && when == 9 && d.settled && d.edge == 5);
}

static void roots_are_whole(void)
{
    for (uint64_t x = 0; x < 1ULL << 52; x = x * 3 + 1) {
        uint64_t r = isqrt64(x);
        CHECK(r * r <= x && (r + 1) * (r + 1) > x);
    }
}

#define RUN(test) (current = #test, test())

int main(void)
{
    srand(1);
    RUN(crc_is_zlibs);
    RUN(every_block_comes_back);
    RUN(no_single_damage_gets_through);
    RUN(noise_is_refused_within_bounds);
    RUN(roots_are_whole);
    RUN(intervals_follow_the_square_root);
    RUN(moves_end_where_they_must);
    RUN(moves_keep_speed_and_take_the_time_of_a_trapezoid);
    RUN(a_halt_stops_within_the_braking_distance);
    RUN(the_run_up_reaches_the_speed);
    RUN(credit_is_absolute_and_never_shrinks);
    RUN(events_that_the_host_has_not_seen_are_never_pushed_out);
    RUN(strobes_are_timed_against_their_trigger);
    RUN(commands_run_once_and_in_order);
    RUN(bouncing_contacts_settle_once_at_their_first_touch);
    if (failures)
        printf("%d checks failed\n", failures);
    else
        printf("all firmware parts hold\n");
    return failures != 0;
}
