#include "link.h"

#include <string.h>
#include <util/atomic.h>

#include "board/stack.h"
#include "frame.h"
#include "inputs/clock.h"
#include "machine/commands.h"
#include "machine/homing.h"
#include "machine/machine.h"
#include "machine/sweep.h"
#include "motion/motion.h"
#include "motion/steps.h"
#include "uart.h"
#include "window.h"

#ifndef WIRE_CRC
#error "the Makefile defines WIRE_CRC"
#endif

#define RX_BLOCK (COMMAND_BODY_MAX + BLOCK_OVERHEAD + 1)
#define TX_BLOCK (BODY_MAX + BLOCK_OVERHEAD)
#define BYTES_PER_POLL 16 /* so that one pass of the loop stays short */
#define REPORT_GAP_MS 5   /* unasked reports come no faster: building one costs as much as eight steps at full speed */

_Static_assert(sizeof(struct report_body) + REPORT_EVENTS_MAX * sizeof(struct event_body) <= BODY_MAX, "a report fits");
_Static_assert(sizeof(struct segment_body) <= COMMAND_BODY_MAX && sizeof(struct config_body) <= COMMAND_BODY_MAX,
               "commands fit");

static struct window window;
static uint8_t block[RX_BLOCK], block_size;
static uint8_t reply[TX_BLOCK];
static uint32_t damaged, replies_dropped, reported_triggers, reported_strobes, report_ms;
static uint16_t loop_max_us;
static uint8_t reported[5];
static uint8_t reset_cause;
static uint32_t boot_id;

void link_init(uint32_t boot, uint8_t cause)
{
    boot_id = boot;
    reset_cause = cause;
}

void link_loop_time(uint16_t us)
{
    if (us > loop_max_us)
        loop_max_us = us;
}

/* Send the block whose body of this size is in reply + 3; returns 0 if there is no room (the host asks again). */
static uint8_t send(uint8_t type, uint8_t sequence, uint8_t size)
{
    static uint8_t encoded[TX_BLOCK + 2];
    uint8_t length;

    if (uart_room() < size + BLOCK_OVERHEAD + 2) {
        replies_dropped++;
        return 0;
    }
    motion_pump(); /* a full queue carries the steps over the longest computation there is */
    reply[0] = size;
    reply[1] = sequence;
    reply[2] = type;
    length = frame_cobs_encode(reply, frame_close(reply), encoded);
    encoded[length++] = 0;
    uart_write(encoded, length);
    return 1;
}

static void send_ack(uint8_t sequence, uint8_t result)
{
    struct ack_body *ack = (struct ack_body *)(reply + 3);

    ack->result = result;
    ack->expected_sequence = window.expected;
    send(MSG_ACK, sequence, sizeof *ack);
}

static uint32_t config_crc(void)
{
    return frame_crc32(0, (const uint8_t *)&machine.config, sizeof machine.config);
}

static void send_hello(uint8_t sequence, uint32_t previous_nonce)
{
    struct hello_reply_body *h = (struct hello_reply_body *)(reply + 3);

    h->major = PROTOCOL_MAJOR;
    h->minor = PROTOCOL_MINOR;
    h->firmware_version = FIRMWARE_VERSION;
    h->wire_crc = WIRE_CRC;
    h->config_crc = config_crc();
    h->boot_id = boot_id;
    h->previous_nonce = previous_nonce;
    h->reset_cause = reset_cause;
    send(MSG_HELLO, sequence, sizeof *h);
}

static uint8_t put_event(uint32_t id, struct event_body *out)
{
    const struct event *found;
    struct event e = {0};

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        found = ledger_event(&steps_ledger, id);
        if (found)
            e = *found;
    }
    if (!found)
        return 0;
    out->trigger_id = id;
    out->position = e.position;
    out->cycles = ((uint64_t)e.ticks_high << 16 | e.ticks_low) * CYCLES_PER_TICK;
    out->strobe_delay_us = e.strobe_delay == STROBE_NONE ? STROBE_NONE : e.strobe_delay / (TICKS_PER_S / 1000000);
    out->segment_id = e.segment_id;
    return 1;
}

static uint8_t send_report(uint8_t sequence, uint32_t first_event)
{
    struct report_body *r = (struct report_body *)(reply + 3);
    struct event_body *events = (struct event_body *)(r + 1);
    uint8_t count = 0;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        r->triggers = steps_ledger.fired;
        r->strobes = steps_ledger.strobes;
        r->may_trigger_through = steps_ledger.granted;
    }
    r->expected_sequence = window.expected;
    r->state = machine.state;
    r->hold_reason = machine.hold_reason;
    r->stop_reason = machine.stop_reason;
    r->alarm = machine.alarm;
    r->flags = machine_flags();
    r->position = steps_position();
    r->segment_id = sweep_segment_id();
    r->shots_left = sweep_shots_left();
    r->zero_id = machine.zero_id;
    r->steps_lost = machine.steps_lost;
    r->cycles = steps_cycles();
    while (count < REPORT_EVENTS_MAX && put_event(first_event + count, &events[count]))
        count++;
    r->event_count = count;
    return send(MSG_REPORT, sequence, sizeof *r + count * sizeof *events);
}

static void send_diagnosis(uint8_t sequence)
{
    struct diagnosis_body *d = (struct diagnosis_body *)(reply + 3);

    d->stack_free_min = stack_free_min();
    d->ram_size = stack_ram_size();
    d->loop_max_us = loop_max_us;
    loop_max_us = 0;
    d->commands_run = window.run;
    d->duplicates = window.duplicates;
    d->gaps = window.gaps;
    d->damaged = damaged;
    d->receive_overruns = uart_overruns();
    d->replies_dropped = replies_dropped;
    d->reset_cause = reset_cause;
    send(MSG_DIAGNOSIS, sequence, sizeof *d);
}

/* Size of the body that each command has; 0xFF: no such command. */
static uint8_t body_size(uint8_t type)
{
    switch (type) {
    case CMD_CONFIGURE: return sizeof(struct config_body);
    case CMD_STATUS: return sizeof(struct status_body);
    case CMD_MOVE: return sizeof(struct move_body);
    case CMD_SEGMENT: return sizeof(struct segment_body);
    case CMD_GRANT: return sizeof(struct grant_body);
    case CMD_ZERO: return sizeof(struct zero_body);
    case CMD_LAMP: return sizeof(struct lamp_body);
    case CMD_EVENTS: return sizeof(struct events_body);
    default: return type > CMD_HELLO && type <= CMD_LAST ? 0 : 0xFF;
    }
}

static uint8_t grant(int32_t may_trigger_through)
{
    if (may_trigger_through < -1)
        return RESULT_RANGE;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        ledger_grant(&steps_ledger, may_trigger_through);
    }
    return RESULT_OK;
}

static uint8_t seen(uint32_t events_seen)
{
    uint8_t known;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        known = ledger_seen(&steps_ledger, events_seen);
    }
    return known ? RESULT_OK : RESULT_RANGE;
}

static uint8_t run(uint8_t type, const void *body)
{
    switch (type) {
    case CMD_CONFIGURE: return command_configure(body);
    case CMD_STATUS: return seen(((const struct status_body *)body)->events_seen);
    case CMD_MOVE: return command_move(body);
    case CMD_SEGMENT: return sweep_begin(body);
    case CMD_GRANT: return grant(((const struct grant_body *)body)->may_trigger_through);
    case CMD_HOLD: return command_hold(HOLD_HOST);
    case CMD_RESUME: return command_resume();
    case CMD_STOP: return command_stop(STOP_HOST);
    case CMD_HOME: return homing_begin(0);
    case CMD_ZERO: return command_zero(((const struct zero_body *)body)->position);
    case CMD_TOUCH: return homing_begin(1);
    case CMD_LAMP: return machine_lamp(((const struct lamp_body *)body)->on);
    case CMD_CLEAR: return command_clear();
    default: return RESULT_OK; /* questions change nothing */
    }
}

/* Questions are answered by their message, all else by an acknowledgement. */
static void answer(uint8_t type, uint8_t sequence, uint8_t result)
{
    if (result != RESULT_OK)
        send_ack(sequence, result);
    else if (type == CMD_STATUS)
        send_report(sequence, steps_ledger.seen);
    else if (type == CMD_EVENTS)
        send_report(sequence, ((struct events_body *)(block + 3))->first);
    else if (type == CMD_DIAGNOSE)
        send_diagnosis(sequence);
    else
        send_ack(sequence, result);
}

static void take_hello(void)
{
    const struct hello_body *h = (const struct hello_body *)(block + 3);
    static uint32_t previous;

    if (block[0] != sizeof *h || h->nonce == 0)
        return;
    if (h->nonce != window.nonce)
        previous = window.nonce;
    if (h->major == PROTOCOL_MAJOR)
        window_open(&window, h->nonce);
    send_hello(block[1], previous);
}

static void take_block(void)
{
    uint8_t sequence = block[1], type = block[2];
    uint8_t result = RESULT_UNKNOWN;

    if (type == CMD_HELLO) {
        machine_heard();
        take_hello();
        return;
    }
    switch (window_judge(&window, sequence)) {
    case WINDOW_NO_SESSION:
        send_ack(sequence, RESULT_NO_SESSION);
        return;
    case WINDOW_GAP:
        send_ack(sequence, RESULT_GAP);
        return;
    case WINDOW_REPEAT:
        result = window_result(&window, sequence);
        break;
    case WINDOW_RUN:
        if (block[0] == body_size(type))
            result = run(type, block + 3);
        window_done(&window, result);
        break;
    }
    machine_heard();
    answer(type, sequence, result);
}

static void end_of_block(void)
{
    if (block_size > sizeof block) {
        damaged++; /* too long */
    } else if (block_size) {
        if (frame_open(block, block_size)) {
            take_block();
        } else {
            damaged++;
            if (window.nonce)
                send_ack(window.expected, RESULT_BAD_BLOCK);
        }
    }
    block_size = 0;
}

static void take_bytes(void)
{
    int16_t byte;

    if (uart_room() < TX_BLOCK + 2)
        return; /* an answer would not fit: the bytes wait, the host's window bounds them */
    for (uint8_t i = 0; i < BYTES_PER_POLL && (byte = uart_read()) >= 0; i++) {
        if (byte == 0) {
            end_of_block();
            return; /* at most one block per pass */
        }
        if (block_size < sizeof block)
            block[block_size] = (uint8_t)byte;
        if (block_size <= sizeof block)
            block_size++;
    }
}

static void take_realtime(void)
{
    uint8_t flags = uart_realtime();

    if (flags & REALTIME_ESTOP)
        machine_alarm(ALARM_ESTOP_BYTE);
    if (flags & REALTIME_STOP)
        command_stop(STOP_REALTIME);
    if (flags & REALTIME_HOLD)
        command_hold(HOLD_REALTIME);
}

/* A report when something has happened that the host waits for. Best effort: what is lost it asks for. */
static void report_changes(void)
{
    uint8_t now[5] = {machine.state, machine.hold_reason, machine.stop_reason, machine.alarm, machine_flags()};
    uint32_t triggers, strobes, seen_id;

    if (!window.nonce || clock_ms() - report_ms < REPORT_GAP_MS)
        return;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        triggers = steps_ledger.fired;
        strobes = steps_ledger.strobes;
        seen_id = steps_ledger.seen;
    }
    if (triggers == reported_triggers && strobes == reported_strobes && !memcmp(now, reported, sizeof now))
        return;
    if (uart_room() < TX_BLOCK + 2)
        return;
    if (reported_triggers < seen_id)
        reported_triggers = seen_id;
    uint32_t first = reported_triggers < triggers ? reported_triggers : seen_id;
    if (triggers - first > EVENT_MEMORY)
        first = triggers - EVENT_MEMORY;
    send_report(0, first);
    report_ms = clock_ms();
    memcpy(reported, now, sizeof now);
    reported_strobes = strobes;
    reported_triggers = triggers - first > REPORT_EVENTS_MAX ? first + REPORT_EVENTS_MAX : triggers;
}

void link_poll(void)
{
    take_realtime();
    if (!motion_slack())
        return; /* steps come first; what arrives waits, and is sent again if it must */
    take_bytes();
    motion_pump();
    if (!motion_slack())
        return;
    report_changes();
}
