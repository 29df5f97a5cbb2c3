#include "ledger.h"

void ledger_init(struct ledger *l)
{
    l->fired = l->strobes = l->seen = 0;
    l->granted = -1;
}

void ledger_grant(struct ledger *l, int32_t may_trigger_through)
{
    if (may_trigger_through > l->granted)
        l->granted = may_trigger_through;
}

uint8_t ledger_seen(struct ledger *l, uint32_t id)
{
    if (id > l->fired)
        return 0;
    if (id > l->seen)
        l->seen = id;
    return 1;
}

uint8_t ledger_may(const struct ledger *l, uint32_t id)
{
    return (int32_t)id <= l->granted && id - l->seen < EVENT_MEMORY;
}

uint32_t ledger_credit(const struct ledger *l, uint32_t id, uint32_t limit)
{
    uint32_t granted = l->granted < (int32_t)id ? 0 : (uint32_t)(l->granted - (int32_t)id) + 1;
    uint32_t room = EVENT_MEMORY - (id - l->seen);

    if (granted > room)
        granted = room;
    return granted < limit ? granted : limit;
}

void ledger_fire(struct ledger *l, int32_t position, uint32_t ticks_high, uint16_t ticks_low, uint16_t segment_id)
{
    struct event *e = &l->events[l->fired % EVENT_MEMORY];

    e->position = position;
    e->ticks_high = ticks_high;
    e->ticks_low = ticks_low;
    e->segment_id = segment_id;
    e->strobe_delay = STROBE_NONE;
    l->fired++;
}

void ledger_strobe(struct ledger *l, uint32_t ticks_high, uint16_t ticks_low)
{
    l->strobes++;
    if (l->fired == 0)
        return;
    struct event *e = &l->events[(l->fired - 1) % EVENT_MEMORY];
    uint32_t high = ticks_high - e->ticks_high - (ticks_low < e->ticks_low);
    if (e->strobe_delay == STROBE_NONE && high < 0xFFFF)
        e->strobe_delay = high << 16 | (uint16_t)(ticks_low - e->ticks_low);
}

const struct event *ledger_event(const struct ledger *l, uint32_t id)
{
    if (id >= l->fired || l->fired - id > EVENT_MEMORY)
        return 0;
    return &l->events[id % EVENT_MEMORY];
}
