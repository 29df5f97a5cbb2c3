/* window - each command runs exactly once, in order, however often its block arrives. Pure. */
#ifndef WINDOW_H
#define WINDOW_H
#include <stdint.h>

#include "protocol.h"

struct window {
    uint8_t expected;
    uint8_t results[RESULT_MEMORY];
    uint8_t remembered; /* valid entries in results, at most RESULT_MEMORY */
    uint32_t nonce;     /* of the session; 0: none */
    uint32_t run, duplicates, gaps;
};

enum window_verdict { WINDOW_RUN, WINDOW_REPEAT, WINDOW_GAP, WINDOW_NO_SESSION };

/* What to do with a valid block of this sequence number. */
enum window_verdict window_judge(struct window *w, uint8_t sequence);

/* The expected block has run with this result. */
void window_done(struct window *w, uint8_t result);

/* The stored result of a repeated block. */
uint8_t window_result(const struct window *w, uint8_t sequence);

/* Open a session. A repeated hello of the same session changes nothing. */
void window_open(struct window *w, uint32_t nonce);
#endif
