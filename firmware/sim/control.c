#include <errno.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "bench.h"

#define CLIENTS 8
#define LINE_SIZE 512

static int listener = -1;
static struct client {
    int fd, watches, used;
    char text[LINE_SIZE];
} clients[CLIENTS];

int control_init(const char *path)
{
    struct sockaddr_un address = {.sun_family = AF_UNIX};

    for (int i = 0; i < CLIENTS; i++)
        clients[i].fd = -1;
    if (!path)
        return 0;
    if (strlen(path) >= sizeof address.sun_path)
        return -1;
    strcpy(address.sun_path, path);
    listener = socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    unlink(path);
    if (bind(listener, (struct sockaddr *)&address, sizeof address) < 0)
        return -1;
    return listen(listener, CLIENTS);
}

static void drop(struct client *c)
{
    close(c->fd);
    c->fd = -1;
}

/* A witness must not lose lines: the emulation waits for a slow reader. */
static void say(struct client *c, const char *text)
{
    size_t left = strlen(text);

    while (left && c->fd >= 0) {
        ssize_t n = send(c->fd, text, left, MSG_NOSIGNAL);
        if (n < 0 && errno != EINTR) {
            drop(c);
            return;
        }
        if (n > 0) {
            text += n;
            left -= n;
        }
    }
}

void control_tell(const char *format, ...)
{
    char text[LINE_SIZE];
    va_list list;

    va_start(list, format);
    vsnprintf(text, sizeof text - 1, format, list);
    va_end(list);
    strcat(text, "\n");
    for (int i = 0; i < CLIENTS; i++)
        if (clients[i].fd >= 0 && clients[i].watches)
            say(&clients[i], text);
}

static void state_line(char *out, size_t size)
{
    snprintf(out, size,
             "ok position=%lld steps=%llu triggers=%llu delivered=%llu lamp=%d driver=%d limit=%d estop=%d step_pin=%d "
             "trigger_pin=%d cycles=%llu bytes_in=%llu bytes_out=%llu hurt=%llu port=%s\n",
             (long long)rig.position, (unsigned long long)rig.steps, (unsigned long long)rig.triggers,
             (unsigned long long)rig.delivered, rig.lamp_pin, rig.driver_pin, rig.limit_level, rig.estop,
             rig.step_pin, rig.trigger_pin, (unsigned long long)rig.avr->cycle, (unsigned long long)line.bytes_in,
             (unsigned long long)line.bytes_out, (unsigned long long)line.hurt, line_name());
}

static int set_log(const char *path)
{
    if (rig.log)
        fclose(rig.log);
    rig.log = strcmp(path, "off") ? fopen(path, "w") : NULL;
    return rig.log || !strcmp(path, "off");
}

static int set_limit(const char *how)
{
    if (!strcmp(how, "auto"))
        rig.limit_forced = -1;
    else if (!strcmp(how, "press") || !strcmp(how, "release"))
        rig.limit_forced = how[0] == 'p';
    else
        return 0;
    return 1;
}

/* Knobs with one number. */
static int set_number(const char *knob, double x)
{
    if (!strcmp(knob, "drop"))
        rig.drop_at = rig.triggers + (uint64_t)x;
    else if (!strcmp(knob, "limit_at"))
        rig.limit_at = (int64_t)x;
    else if (!strcmp(knob, "bounce_ms"))
        rig.bounce_cycles = (uint32_t)(x * 16000);
    else if (!strcmp(knob, "estop"))
        rig.estop = x != 0;
    else if (!strcmp(knob, "slip"))
        rig.position += (int64_t)x;
    else if (!strcmp(knob, "stall"))
        rig.stalled = x != 0;
    else if (!strcmp(knob, "strobes"))
        rig.strobes = x != 0;
    else if (!strcmp(knob, "strobe_delay_us"))
        rig.strobe_delay_cycles = (uint32_t)(x * 16);
    else if (!strcmp(knob, "noise"))
        line.noise = x;
    else if (!strcmp(knob, "seed"))
        line_seed((uint64_t)x);
    else if (!strcmp(knob, "pace"))
        pace = x;
    else if (!strcmp(knob, "freeze_ms"))
        frozen_until_ns = now_ns() + (uint64_t)(x * 1e6);
    else
        return 0;
    return 1;
}

static int set_plain(const char *knob)
{
    if (!strcmp(knob, "unplug"))
        line_unplug();
    else if (!strcmp(knob, "plug"))
        return line_plug() == 0;
    else if (!strcmp(knob, "hang"))
        return rig_hang();
    else if (!strcmp(knob, "quit"))
        running = 0;
    else
        return 0;
    return 1;
}

static void obey(struct client *c, char *text)
{
    char answer[LINE_SIZE] = "ok\n", knob[64] = "", value[400] = "";
    int done = 1, words = sscanf(text, "%63s %399s", knob, value);

    if (!strcmp(knob, "state"))
        state_line(answer, sizeof answer);
    else if (!strcmp(knob, "watch"))
        c->watches = 1;
    else if (words == 2 && !strcmp(knob, "log"))
        done = set_log(value);
    else if (words == 2 && !strcmp(knob, "limit"))
        done = set_limit(value);
    else if (words == 2 && !strcmp(knob, "reset"))
        rig_reset(value);
    else
        done = words == 2 ? set_number(knob, atof(value)) : set_plain(knob);
    say(c, done ? answer : "no such knob\n");
}

static void serve(struct client *c)
{
    ssize_t got = recv(c->fd, c->text + c->used, sizeof c->text - 1 - c->used, MSG_DONTWAIT);
    char *end;

    if (got == 0 || (got < 0 && errno != EAGAIN) || c->used + got >= (ssize_t)sizeof c->text - 1) {
        drop(c);
        return;
    }
    if (got > 0)
        c->used += got;
    c->text[c->used] = 0;
    while (c->fd >= 0 && (end = strchr(c->text, '\n'))) {
        *end = 0;
        obey(c, c->text);
        c->used -= end + 1 - c->text;
        memmove(c->text, end + 1, c->used + 1);
    }
}

void control_poll(void)
{
    static unsigned turn;

    if (listener >= 0 && turn++ % 16 == 0) {
        int fd = accept(listener, NULL, NULL);
        for (int i = 0; fd >= 0 && i < CLIENTS; i++)
            if (clients[i].fd < 0) {
                clients[i] = (struct client){.fd = fd};
                fd = -1;
            }
        if (fd >= 0)
            close(fd);
    }
    for (int i = 0; i < CLIENTS; i++)
        if (clients[i].fd >= 0)
            serve(&clients[i]);
}
