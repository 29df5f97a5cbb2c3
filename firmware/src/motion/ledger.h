/* ledger - which triggers may fire and which have: credit, hysteresis, the last EVENT_MEMORY events. Pure. */
#ifndef LEDGER_H
#define LEDGER_H
#include <stdint.h>

#include "protocol.h"

struct event {
    int32_t position;
    uint32_t ticks_high; /* 48 bit time stamp */
    uint16_t ticks_low;
    uint16_t segment_id;
    uint32_t strobe_delay; /* ticks; STROBE_NONE: not seen */
};

struct ledger {
    struct event events[EVENT_MEMORY];
    uint32_t fired;       /* id of the next trigger */
    uint32_t strobes;
    uint32_t seen;        /* the host has all events below this id */
    int32_t granted;      /* may_trigger_through; -1: nothing */
};

void ledger_init(struct ledger *l);

/* A grant is absolute and never takes back. */
void ledger_grant(struct ledger *l, int32_t may_trigger_through);

/* The host has all events below id; ids that have not fired are refused with 0. */
uint8_t ledger_seen(struct ledger *l, uint32_t id);

/* May trigger id fire? Only if granted, and if its event will not push out one that the host has not seen. */
uint8_t ledger_may(const struct ledger *l, uint32_t id);

/* Shots from id on that may fire now, at most limit. */
uint32_t ledger_credit(const struct ledger *l, uint32_t id, uint32_t limit);

/* Record one trigger; called in an interrupt. */
void ledger_fire(struct ledger *l, int32_t position, uint32_t ticks_high, uint16_t ticks_low, uint16_t segment_id);

/* Record one strobe against the last trigger; called in an interrupt. */
void ledger_strobe(struct ledger *l, uint32_t ticks_high, uint16_t ticks_low);

/* The event of trigger id, or 0 if it is not kept. */
const struct event *ledger_event(const struct ledger *l, uint32_t id);
#endif
