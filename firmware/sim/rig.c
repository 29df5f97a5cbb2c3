#include <stdlib.h>
#include <string.h>

#include "avr_ioport.h"
#include "avr_timer.h"
#include "bench.h"

#define PORTB_ADDRESS 0x25
#define PORTD_ADDRESS 0x2B
#define TCCR1A_ADDRESS 0x80
#define TCCR1C_ADDRESS 0x82
#define MCUSR_ADDRESS 0x54
#define DIR_BIT 7
#define US_CYCLES 16

void (*rig_tell)(const char *format, ...);
struct rig rig = {.limit_at = -1000000000, .limit_forced = -1, .limit_level = -1, .strobes = 1,
                  .strobe_delay_cycles = 50 * US_CYCLES, .strobe_cycles = 100 * US_CYCLES};

static uint16_t saved_code;
static avr_flashaddr_t saved_at;
static int hanging;

static void note(const char *what, long long number, int level)
{
    if (rig.log)
        fprintf(rig.log, "%s %lld %lld %llu %d\n", what, number, (long long)rig.position,
                (unsigned long long)rig.avr->cycle, level);
}

static void drive(char port, int bit, int level)
{
    avr_ioport_external_t pull = {.name = port};

    /* The port's own pull-ups would win over the level at every write to the port. */
    static uint8_t mask_b, value_b, mask_d, value_d;
    uint8_t *mask = port == 'B' ? &mask_b : &mask_d, *value = port == 'B' ? &value_b : &value_d;
    *mask |= 1 << bit;
    *value = (*value & ~(1 << bit)) | (level ? 1 << bit : 0);
    pull.mask = *mask;
    pull.value = *value;
    avr_ioctl(rig.avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(port), &pull);
    avr_raise_irq(avr_io_getirq(rig.avr, AVR_IOCTL_IOPORT_GETIRQ(port), bit), level);
}

static void on_step(int level)
{
    if (level) {
        rig.steps++;
        if (!rig.stalled)
            rig.position += rig.avr->data[PORTD_ADDRESS] & (1 << DIR_BIT) ? 1 : -1;
        note("step", rig.steps, level);
    }
    rig.step_pin = level;
}

static avr_cycle_count_t strobe_off(avr_t *avr, avr_cycle_count_t when, void *param)
{
    drive('B', 0, 0);
    return 0;
}

static avr_cycle_count_t strobe_on(avr_t *avr, avr_cycle_count_t when, void *param)
{
    drive('B', 0, 1);
    avr_cycle_timer_register(avr, rig.strobe_cycles, strobe_off, NULL);
    return 0;
}

static void tell_edge(const char *what)
{
    rig_tell("%s %llu %lld %llu", what, (unsigned long long)rig.triggers - 1, (long long)rig.position,
                 (unsigned long long)rig.avr->cycle);
}

static void on_trigger(int level)
{
    rig.trigger_pin = level;
    if (!level)
        return;
    note("trigger", rig.triggers, level);
    if (++rig.triggers == rig.drop_at) {
        tell_edge("dropped");
        return;
    }
    rig.delivered++;
    tell_edge("trigger");
    if (rig.strobes)
        avr_cycle_timer_register(rig.avr, rig.strobe_delay_cycles, strobe_on, NULL);
}

/* simavr 1.6 knows no forced match and lets port writes through while a compare output is connected. So the two outputs
 * are modelled here as the data sheet has them: connected (COM bits not 0) a pin shows its latch, else its port bit. */
static struct output {
    int latch, com, port, level;
    void (*moved)(int level);
} step_output = {.moved = on_step}, trigger_output = {.moved = on_trigger};

static void show(struct output *o)
{
    int level = o->com ? o->latch : o->port;

    if (level != o->level) {
        o->level = level;
        o->moved(level);
    }
}

static void match(struct output *o)
{
    if (o->com == 1)
        o->latch = !o->latch;
    else if (o->com)
        o->latch = o->com == 3;
    show(o);
}

static void on_match(struct avr_irq_t *irq, uint32_t value, void *param)
{
    struct output *o = param;

    /* In set mode a 0 is what simavr raises at overflows and writes: no match. Other modes never wait for a match here. */
    if (o->com == 3 && (value & 1))
        match(o);
}

static void on_tccr1a(avr_t *avr, avr_io_addr_t address, uint8_t value, void *param)
{
    step_output.com = value >> 6;
    trigger_output.com = value >> 4 & 3;
    show(&step_output);
    show(&trigger_output);
}

static void on_tccr1c(avr_t *avr, avr_io_addr_t address, uint8_t value, void *param)
{
    if (value & 0x80)
        match(&step_output);
    if (value & 0x40)
        match(&trigger_output);
}

static void on_portb(avr_t *avr, avr_io_addr_t address, uint8_t value, void *param)
{
    step_output.port = value >> 1 & 1;
    trigger_output.port = value >> 2 & 1;
    show(&step_output);
    show(&trigger_output);
}

static void outputs_init(avr_t *avr)
{
    avr_irq_t *compare = avr_io_getirq(avr, AVR_IOCTL_TIMER_GETIRQ('1'), TIMER_IRQ_OUT_COMP);

    avr_irq_register_notify(compare, on_match, &step_output);
    avr_irq_register_notify(compare + 1, on_match, &trigger_output);
    avr_register_io_write(avr, TCCR1A_ADDRESS, on_tccr1a, NULL);
    avr_register_io_write(avr, TCCR1C_ADDRESS, on_tccr1c, NULL);
    avr_register_io_write(avr, PORTB_ADDRESS, on_portb, NULL);
}

/* A reset disconnects both outputs and clears the latches. */
static void outputs_reset(void)
{
    step_output.latch = step_output.com = step_output.port = 0;
    trigger_output.latch = trigger_output.com = trigger_output.port = 0;
    show(&step_output);
    show(&trigger_output);
}

static void on_lamp(struct avr_irq_t *irq, uint32_t value, void *param)
{
    int level = value & 1;

    if (level != rig.lamp_pin) {
        rig.lamp_pin = level;
        rig.lamp_changes++;
        note("lamp", rig.lamp_changes, level);
        rig_tell("lamp %d %llu", level, (unsigned long long)rig.avr->cycle);
    }
}

static void on_driver(struct avr_irq_t *irq, uint32_t value, void *param)
{
    int on = !(value & 1);

    if (on != rig.driver_pin) {
        rig.driver_pin = on;
        note("driver", 0, on);
        rig_tell("driver %d %llu", on, (unsigned long long)rig.avr->cycle);
    }
}

void rig_init(avr_t *avr)
{
    rig.avr = avr;
    outputs_init(avr);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 5), on_lamp, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 6), on_driver, NULL);
    drive('B', 0, 0);
    drive('D', 3, rig.estop);
    rig_poll();
}

void rig_poll(void)
{
    static int pressed = -1, estop = -1;
    int now = rig.limit_forced >= 0 ? rig.limit_forced : rig.position <= rig.limit_at;
    int level = now;

    if (now != pressed) {
        if (pressed >= 0)
            rig.bounce_until = rig.avr->cycle + rig.bounce_cycles;
        pressed = now;
    }
    if (rig.avr->cycle < rig.bounce_until)
        level = rand() & 1; /* seeded by the noise seed */
    if (level != rig.limit_level) {
        rig.limit_level = level;
        drive('D', 4, level); /* normally closed to ground: open, and high, when pressed */
    }
    if (rig.estop != estop) {
        estop = rig.estop;
        drive('D', 3, estop);
    }
}

void rig_reset(const char *cause)
{
    uint8_t flag = !strcmp(cause, "power") ? 1 : !strcmp(cause, "brownout") ? 4 : !strcmp(cause, "watchdog") ? 8 : 2;

    avr_reset(rig.avr);
    outputs_reset();
    rig.avr->data[MCUSR_ADDRESS] = flag;
    rig.limit_level = -1;
    drive('B', 0, 0);
    drive('D', 3, rig.estop);
    rig_poll();
    rig_tell("reset %s %llu", cause, (unsigned long long)rig.avr->cycle);
}

int rig_hang(void)
{
    if (hanging)
        return 0;
    saved_at = rig.avr->pc & ~1u;
    memcpy(&saved_code, rig.avr->flash + saved_at, 2);
    memcpy(rig.avr->flash + saved_at, "\xFF\xCF", 2); /* rjmp to itself */
    hanging = 1;
    return 1;
}

/* Called by the loop when the program counter is back at the start: the flash is whole again. */
void rig_unhang(void)
{
    if (!hanging)
        return;
    memcpy(rig.avr->flash + saved_at, &saved_code, 2);
    hanging = 0;
}
