/* commands - commands of the host: checked against state and ranges, then begun. Each returns a RESULT_ code. */
#ifndef COMMANDS_H
#define COMMANDS_H
#include <stdint.h>

#include "protocol.h"

uint8_t command_configure(const struct config_body *config);
uint8_t command_move(const struct move_body *move);
uint8_t command_hold(uint8_t reason);
uint8_t command_resume(void);
uint8_t command_stop(uint8_t reason);
uint8_t command_zero(int32_t position);
uint8_t command_clear(void);

#endif
