/* wake: an eventfd at which one thread waits, alone or beside its sockets, and to which others write when
 * there is something for it to look at. */
#ifndef LIGHTMILL_WAKE_H
#define LIGHTMILL_WAKE_H

#include "common/base.h"

/* *wake is -1 after a failure, RESULT_LIMIT. */
result_t wake_new(int *wake);
/* -1 is allowed, here and below. */
void wake_close(int wake);
/* Wakes who waits, or will. */
void wake_up(int wake);
/* Waits until there was a wake_up, or so long. */
void wake_wait(int wake, int milliseconds);
/* For who waits by other means: forgets the wake_up that was seen. */
void wake_clear(int wake);

#endif
