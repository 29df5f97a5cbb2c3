/* bench - the emulated rig around the firmware: motor, switches, camera wires, serial line, and the knobs for faults. */
#ifndef BENCH_H
#define BENCH_H
#include <stdint.h>
#include <stdio.h>

#include "sim_avr.h"

#define CHUNK_CYCLES 4000 /* between looks at the world outside: 0.25 ms */

struct rig {
    avr_t *avr;
    int64_t position;       /* where the stage truly is, microsteps from the start */
    uint64_t steps;         /* rising edges of STEP */
    uint64_t triggers;      /* rising edges of TRIGGER, dropped ones too */
    uint64_t delivered;     /* those that reached the camera */
    uint64_t drop_at;       /* the edge that is lost on the way; 0: none */
    int64_t limit_at;       /* the switch is pressed at and below this position */
    int8_t limit_forced;    /* -1: by position */
    uint32_t bounce_cycles; /* how long its contacts bounce */
    uint64_t bounce_until;
    int limit_level, estop;
    int stalled;            /* STEP edges no longer move the stage */
    int strobes;            /* the camera answers with a strobe */
    uint32_t strobe_delay_cycles, strobe_cycles;
    int step_pin, trigger_pin, lamp_pin, driver_pin;
    uint64_t lamp_changes;
    FILE *log;              /* one line per edge, or NULL */
};

extern struct rig rig;
extern void (*rig_tell)(const char *format, ...); /* gets each event of the pins as a line of text; set before rig_init */
void rig_init(avr_t *avr);
void rig_poll(void);                    /* once per chunk: switches follow the stage */
void rig_reset(const char *cause);
int rig_hang(void);                     /* the program stops making progress, until the watchdog bites */
void rig_unhang(void);                  /* the program runs anew */

struct line {
    double noise;                       /* share of bytes that are hurt, each way */
    uint64_t seed;
    uint64_t bytes_in, bytes_out, hurt;
};

extern struct line line;
int line_init(avr_t *avr, const char *link_path);
void line_poll(void);
void line_seed(uint64_t seed);
void line_unplug(void);
int line_plug(void);
const char *line_name(void);

int control_init(const char *path);
void control_poll(void);
void control_tell(const char *format, ...) __attribute__((format(printf, 1, 2))); /* to all who watch */

extern double pace;                     /* 1: real time; 0: as fast as possible */
extern uint64_t frozen_until_ns;
extern int running;
uint64_t now_ns(void);
void keep_pace(avr_t *avr);             /* sleeps until real time has caught up */
#endif
