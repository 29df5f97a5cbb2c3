/* sweep - a segment of shots: approach, credit, step or fly, settle, trigger; hold and resume. */
#ifndef SWEEP_H
#define SWEEP_H
#include <stdint.h>

#include "protocol.h"

uint8_t sweep_begin(const struct segment_body *segment); /* a RESULT_ code */
void sweep_advance(void);                                /* the next phase; call it at rest */
void sweep_hold(uint8_t reason);
void sweep_resume(void);
uint32_t sweep_shots_left(void);
uint16_t sweep_segment_id(void);

#endif
