/* stage-sim - runs the built firmware with its serial line on a pty, paced to real time or as fast as it goes.
 *
 *   stage-sim ELF [--pace 1] [--link PATH] [--control SOCKET] [--limit-at N] [--position N] [--seed N]
 *
 * The first line on stdout names the port. Knobs and the watch on the pins are lines on the control socket.
 */
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "avr_extint.h"
#include "bench.h"
#include "sim_elf.h"

static void on_signal(int number)
{
    running = 0;
}

static void run_chunk(avr_t *avr)
{
    uint64_t end = avr->cycle + CHUNK_CYCLES;

    while (avr->cycle < end) {
        int state = avr_run(avr);
        if (state == cpu_Crashed || state == cpu_Done) {
            fprintf(stderr, "stage-sim: the processor stopped at pc %x\n", avr->pc);
            exit(1);
        }
        if (avr->pc == 0) {
            rig_unhang();
        }
    }
}

static void quiet(avr_t *avr, const int level, const char *format, va_list list)
{
    if (level == LOG_ERROR)
        vfprintf(stderr, format, list);
}

static const char *option(int argc, char **argv, const char *name, const char *fallback)
{
    for (int i = 2; i + 1 < argc; i += 2)
        if (!strcmp(argv[i], name))
            return argv[i + 1];
    return fallback;
}

static avr_t *load(const char *path)
{
    elf_firmware_t firmware = {0};
    avr_t *avr;

    if (elf_read_firmware(path, &firmware) != 0) {
        fprintf(stderr, "stage-sim: cannot read %s\n", path);
        exit(1);
    }
    avr = avr_make_mcu_by_name("atmega328p");
    avr_init(avr);
    avr_load_firmware(avr, &firmware);
    avr->frequency = 16000000;
    avr_extint_set_strict_lvl_trig(avr, 0, 0); /* else a level on D2 or D3 halves the speed */
    avr_extint_set_strict_lvl_trig(avr, 1, 0);
    return avr;
}

int main(int argc, char **argv)
{
    if (argc < 2) {
        fprintf(stderr, "usage: stage-sim ELF [--pace X] [--link PATH] [--control SOCKET] [--limit-at N]\n");
        return 2;
    }
    pid_t parent = getppid();
    signal(SIGTERM, on_signal);
    signal(SIGINT, on_signal);
    avr_global_logger_set(quiet);
    avr_t *avr = load(argv[1]);
    pace = atof(option(argc, argv, "--pace", "1"));
    rig.limit_at = atoll(option(argc, argv, "--limit-at", "-1000000000"));
    rig.position = atoll(option(argc, argv, "--position", "0"));
    line.seed = strtoull(option(argc, argv, "--seed", "1"), NULL, 10);
    if (line_init(avr, option(argc, argv, "--link", NULL)) < 0
        || control_init(option(argc, argv, "--control", NULL)) < 0) {
        perror("stage-sim");
        return 1;
    }
    rig_tell = control_tell;
    rig_init(avr);
    rig_reset("power");
    printf("port %s\n", line_name());
    fflush(stdout);
    while (running && getppid() == parent) { /* ends with whoever started it */
        run_chunk(avr);
        rig_poll();
        line_poll();
        control_poll();
        keep_pace(avr);
    }
    line_unplug();
    if (rig.log)
        fclose(rig.log);
    return 0;
}
