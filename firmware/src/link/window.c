#include "window.h"

enum window_verdict window_judge(struct window *w, uint8_t sequence)
{
    uint8_t age = w->expected - sequence;

    if (w->nonce == 0)
        return WINDOW_NO_SESSION;
    if (age == 0)
        return WINDOW_RUN;
    if (age <= w->remembered) {
        w->duplicates++;
        return WINDOW_REPEAT;
    }
    w->gaps++;
    return WINDOW_GAP;
}

void window_done(struct window *w, uint8_t result)
{
    w->results[w->expected % RESULT_MEMORY] = result;
    w->expected++;
    w->run++;
    if (w->remembered < RESULT_MEMORY)
        w->remembered++;
}

uint8_t window_result(const struct window *w, uint8_t sequence)
{
    return w->results[sequence % RESULT_MEMORY];
}

void window_open(struct window *w, uint32_t nonce)
{
    if (w->nonce == nonce)
        return;
    w->nonce = nonce;
    w->expected = 0;
    w->remembered = 0;
}
