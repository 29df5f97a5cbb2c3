/* poll - what the main loop does for the machine: alarms, lease, and the next phase once the stage is at rest. */
#ifndef POLL_H
#define POLL_H

void machine_poll(void);

#endif
