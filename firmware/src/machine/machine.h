/* machine - the state that all parts of the machine share, and the steps between its states. */
#ifndef MACHINE_H
#define MACHINE_H
#include <stdint.h>

#include "protocol.h"

enum phase {
    PHASE_NONE,
    PHASE_MOVE,
    PHASE_STOPPING,
    PHASE_APPROACH, /* step mode: to a place from which backlash is taken up */
    PHASE_CREDIT,
    PHASE_STEP,
    PHASE_SETTLE,   /* ends with the trigger */
    PHASE_DWELL,
    PHASE_BACKUP,   /* fly mode: to the beginning of the run-up */
    PHASE_FLY,
    PHASE_FINISH,
    PHASE_BRAKE,    /* on the way to a hold */
    PHASE_HOLD,
    PHASE_HOME_FAST,
    PHASE_HOME_BRAKE,
    PHASE_HOME_BACKOFF,
    PHASE_HOME_SLOW,
    PHASE_HOME_SETTLE,
    PHASE_HOME_LEAVE,
    PHASE_TOUCH_APPROACH,
};

struct machine {
    struct config_body config;
    enum phase phase;
    uint8_t state, hold_reason, stop_reason, alarm, flags;
    uint8_t last_stop;     /* reason to report once PHASE_STOPPING has come to rest */
    uint32_t zero_id, boot_id;
    int32_t steps_lost;
    uint32_t heard_ms;     /* last valid block from the host */
    uint32_t lamp_on_ms;
    uint8_t zeros;
};

extern struct machine machine;

void machine_init(uint32_t boot_id);
void machine_heard(void);           /* a valid block came: the lease starts anew */
uint8_t machine_flags(void);
uint8_t machine_ready(void);        /* RESULT_OK if a motion may begin */
void machine_begin(uint8_t state, enum phase phase);
void machine_end(uint8_t stop_reason);
void machine_alarm(uint8_t code);
void machine_trust(int32_t position); /* the stage is there: a new zero */
uint8_t machine_lamp(uint8_t on);   /* a RESULT_ code */

#endif
