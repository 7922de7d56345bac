/* interrupt: Ctrl-C and SIGTERM in a program that has something to finish: the first is noted, the second
 * ends the process at once, whatever it waits for. SIGHUP, when a terminal is closed, counts as the first,
 * but never as the second; and not at all where it was ignored before (nohup). */
#ifndef LIGHTMILL_INTERRUPT_H
#define LIGHTMILL_INTERRUPT_H

#include <stdatomic.h>
#include <stdbool.h>

/* From now on; before, they end the process as usual. Returns how many there were, a number that goes on
 * counting. */
const atomic_int *interrupt_catch(void);
bool interrupt_seen(void);

#endif
