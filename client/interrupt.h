/* interrupt: Ctrl-C and SIGTERM in a command that has something to finish: the first is noted, the second
 * ends the process at once, whatever it waits for. */
#ifndef LIGHTMILL_INTERRUPT_H
#define LIGHTMILL_INTERRUPT_H

#include <stdbool.h>

/* From now on; before, they end the process as usual. */
void interrupt_catch(void);
bool interrupt_seen(void);

#endif
