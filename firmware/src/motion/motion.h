/* motion - one move at a time: plans its steps into the queue and knows when it has come to rest. */
#ifndef MOTION_H
#define MOTION_H
#include <stdint.h>

#include "protocol.h"

void motion_configure(const struct config_body *config);
void motion_move(int32_t target, uint16_t rate);         /* at rest only; rate 0: the fastest */
/* The same at constant speed, cruise in 1/256 ticks; planned_step returns the ENTRY_ flags of each step. */
void motion_fly(int32_t target, uint32_t cruise, uint8_t (*planned_step)(int32_t position));
void motion_wait(uint32_t ticks, uint8_t flags);         /* at rest: a pause, then ENTRY_ flags */
void motion_halt(void);                                  /* brake */
void motion_kill(void);                                  /* no step after this */
void motion_pump(void);                                  /* plan ahead; call it often */
uint8_t motion_slack(void);                              /* enough is planned for a block to be read or written */
uint8_t motion_idle(void);
uint8_t motion_cruising(void);
uint16_t motion_run_up(uint32_t cruise);                 /* steps from rest to that speed */
uint32_t motion_fly_interval(uint32_t period_us, uint32_t pitch); /* 1/256 ticks per step */
int8_t motion_direction(void);

#endif
