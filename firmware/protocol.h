/* protocol.h - owns every number that host and firmware must agree on; acquire/stages/uno/wire_format.py repeats them and a test
 * compares the two. Only #define NAME number and the packed structs below: no code.
 *
 * A block on the wire is COBS(length, sequence, type, body[length], crc32 little endian over all before it) and a zero.
 * All numbers are little endian. A realtime byte stands alone right after a zero; blocks cannot begin with one, because
 * the first byte of a COBS block of this size is below 0x80.
 */
#ifndef PROTOCOL_H
#define PROTOCOL_H

#include <stdint.h>

#ifndef PROTOCOL_MAJOR
#define PROTOCOL_MAJOR 1
#endif
#define PROTOCOL_MINOR 0
#define FIRMWARE_VERSION 100 /* 1.00 */

#define LINK_BAUD 250000   /* exact at 16 MHz: no rate error to add to noise */
#define BODY_MAX 89        /* bytes of the longest body, firmware to host */
#define COMMAND_BODY_MAX 48 /* bytes of the longest body, host to firmware */
#define BLOCK_OVERHEAD 7   /* length, sequence, type, crc32 */
#define WINDOW_MAX 4       /* blocks that the host may have unanswered */
#define RESULT_MEMORY 8    /* answers kept, so that a resent command is answered and not run again */
#define EVENT_MEMORY 32    /* trigger events kept; triggers stop when the host has not seen this many */
#define REPORT_EVENTS_MAX 2 /* trigger events in one report */
#define TICKS_PER_S 2000000 /* timer ticks; one tick is 8 CPU cycles */
#define CYCLES_PER_TICK 8

/* Realtime bytes. Hold is one byte: a false one costs a resume. The others need a second, different byte. */
#define RT_HOLD 0xF1
#define RT_STOP 0xF2
#define RT_STOP_CONFIRM 0x2D
#define RT_ESTOP 0xF3
#define RT_ESTOP_CONFIRM 0x3C

/* Host to firmware */
#define CMD_HELLO 1      /* struct hello_body */
#define CMD_CONFIGURE 2  /* struct config_body */
#define CMD_STATUS 3     /* struct status_body: answered with a report */
#define CMD_MOVE 4       /* struct move_body */
#define CMD_SEGMENT 5    /* struct segment_body */
#define CMD_GRANT 6      /* struct grant_body */
#define CMD_HOLD 7
#define CMD_RESUME 8
#define CMD_STOP 9
#define CMD_HOME 10
#define CMD_ZERO 11      /* struct zero_body */
#define CMD_TOUCH 12
#define CMD_LAMP 13      /* struct lamp_body */
#define CMD_CLEAR 14     /* leave the alarm state */
#define CMD_DIAGNOSE 15  /* answered with struct diagnosis_body */
#define CMD_EVENTS 16    /* struct events_body: answered with a report that starts at that event */
#define CMD_LAST 16

/* Firmware to host */
#define MSG_HELLO 0x80
#define MSG_ACK 0x81
#define MSG_REPORT 0x82
#define MSG_DIAGNOSIS 0x83

/* Results in an acknowledgement */
#define RESULT_OK 0
#define RESULT_BAD_BLOCK 1    /* damaged: send again from expected_sequence */
#define RESULT_GAP 2          /* out of order: send again from expected_sequence */
#define RESULT_NO_SESSION 3   /* the firmware has restarted: say hello */
#define RESULT_UNKNOWN 4      /* unknown type or wrong length */
#define RESULT_RANGE 5        /* a value out of bounds */
#define RESULT_STATE 6        /* not possible in this state */
#define RESULT_UNTRUSTED 7    /* needs a trusted position: home or zero first */
#define RESULT_ALARM 8        /* an alarm stands: clear it first */

/* States */
#define STATE_IDLE 0
#define STATE_MOVING 1
#define STATE_SWEEPING 2
#define STATE_HOLDING 3
#define STATE_HOMING 4
#define STATE_ALARM 5

/* Why it holds */
#define HOLD_NONE 0
#define HOLD_HOST 1
#define HOLD_REALTIME 2
#define HOLD_NO_CREDIT 3
#define HOLD_LEASE 4

/* Why it stopped last */
#define STOP_NONE 0      /* nothing has moved since the start */
#define STOP_DONE 1      /* the motion reached its end */
#define STOP_HOST 2
#define STOP_REALTIME 3
#define STOP_LEASE 4
#define STOP_ALARM 5

/* Alarms: sticky until CMD_CLEAR */
#define ALARM_NONE 0
#define ALARM_ESTOP_PIN 1
#define ALARM_ESTOP_BYTE 2
#define ALARM_LIMIT 3
#define ALARM_LATE_STEP 4
#define ALARM_UNDERRUN 5
#define ALARM_TRIGGER_OVERRUN 6
#define ALARM_HOMING 7
#define ALARM_RUN_UP 8

/* Flags of a report */
#define FLAG_TRUSTED 1
#define FLAG_CONFIGURED 2
#define FLAG_LAMP 4
#define FLAG_LAMP_READY 8
#define FLAG_LIMIT 16
#define FLAG_ESTOP 32
#define FLAG_DRIVER 64
#define FLAG_TOUCHED 128

/* Why the processor started (MCUSR) */
#define RESET_POWER 1
#define RESET_EXTERNAL 2
#define RESET_BROWN_OUT 4
#define RESET_WATCHDOG 8

/* Flags of the configuration */
#define CONFIG_INVERT_DIRECTION 1
#define CONFIG_LIMIT_CLOSES 2   /* the switch closes when pressed (default: opens, so a broken wire stops the stage) */
#define CONFIG_ESTOP_CLOSES 4
#define CONFIG_HOME_POSITIVE 8  /* the limit switch is at the far end */
#define CONFIG_NO_LIMIT 16      /* no switch is fitted */
#define CONFIG_STROBE_FALLS 32

/* Modes of a segment */
#define MODE_STEP 0
#define MODE_FLY 1

/* Bounds */
#define RATE_MAX 20000          /* microsteps per second */
#define RATE_MIN 1
#define ACCEL_MIN 100           /* microsteps per second squared */
#define ACCEL_MAX 1000000
#define POSITION_MAX 10000000   /* microsteps */
#define SHOTS_MAX 100000
#define WAIT_MAX_US 60000000
#define PULSE_MIN_US 5
#define PULSE_MAX_US 10000
#define LEASE_MIN_MS 50
#define LEASE_MAX_MS 60000
#define STROBE_NONE 0xFFFFFFFF

#define PACKED __attribute__((packed))

struct PACKED hello_body { uint8_t major, minor; uint32_t nonce; };

struct PACKED config_body {
    uint16_t max_rate;        /* microsteps per second */
    uint32_t acceleration;    /* microsteps per second squared */
    uint16_t home_fast, home_slow; /* microsteps per second */
    int32_t home_position;    /* position of the switch's edge */
    int32_t soft_min, soft_max; /* bounds of moves and shots while the position is trusted */
    uint16_t overtravel;      /* how far run-ups may go beyond them */
    uint16_t backoff;         /* how far homing backs off from the switch */
    uint16_t trigger_pulse_us;
    uint16_t lease_ms;        /* silence of the host after which motion holds */
    uint32_t lamp_warm_up_ms;
    uint8_t flags;
};

struct PACKED status_body { uint32_t events_seen; };      /* the host has all events below this id */
struct PACKED move_body { int32_t target; uint8_t relative; uint16_t rate; }; /* rate 0: max_rate */

struct PACKED segment_body {
    uint16_t segment_id;
    uint32_t first_trigger_id; /* that shot 0 will have: refused if the counter stands elsewhere */
    int32_t first, pitch;     /* position of shot 0; signed microsteps between shots */
    uint32_t count;
    uint8_t mode;
    uint32_t settle_us, dwell_us; /* step mode: before and after the trigger */
    uint32_t shot_period_us;  /* fly mode: sets the speed; step mode: the least time between triggers */
    uint16_t run_up;          /* steps from which shot 0 is approached; in fly mode besides the ramp */
    uint16_t resume_credit;   /* shots that must be granted before a hold for credit ends */
};

struct PACKED grant_body { int32_t may_trigger_through; };
struct PACKED zero_body { int32_t position; };
struct PACKED lamp_body { uint8_t on; };
struct PACKED events_body { uint32_t first; };

struct PACKED ack_body { uint8_t result, expected_sequence; };

struct PACKED hello_reply_body {
    uint8_t major, minor;
    uint16_t firmware_version;
    uint32_t wire_crc;        /* crc32 of this file's declarations */
    uint32_t config_crc;      /* crc32 of the configuration in force */
    uint32_t boot_id, previous_nonce; /* the nonce is 0 after a restart */
    uint8_t reset_cause;
};

struct PACKED report_body {
    uint8_t expected_sequence, state, hold_reason, stop_reason, alarm, flags;
    int32_t position;
    uint32_t triggers;        /* fired since the start; the id of the next */
    uint32_t strobes;
    int32_t may_trigger_through;
    uint16_t segment_id;
    uint32_t shots_left;
    uint32_t zero_id;
    int32_t steps_lost;       /* of the last touch */
    uint64_t cycles;
    uint8_t event_count;      /* struct event_body follow */
};

struct PACKED event_body {
    uint32_t trigger_id;
    int32_t position;
    uint64_t cycles;
    uint32_t strobe_delay_us; /* STROBE_NONE: not seen (yet) */
    uint16_t segment_id;
};

struct PACKED diagnosis_body {
    uint16_t stack_free_min;  /* bytes never used between variables and stack */
    uint16_t ram_size;
    uint16_t loop_max_us;     /* since the last diagnosis */
    uint32_t commands_run, duplicates, gaps, damaged, receive_overruns, replies_dropped;
    uint8_t reset_cause;
};

#endif
