/* thread: one way to start a thread, and one to wait for another until a time. */
#ifndef LIGHTMILL_THREAD_H
#define LIGHTMILL_THREAD_H

#include "common/base.h"

#include <pthread.h>

/* Starts a thread, to be joined by the caller. `name`, at most 15 characters, is what tools show.
 * RESULT_LIMIT when the system has no thread left. */
result_t thread_start(pthread_t *thread, const char *name, void *(*run)(void *argument), void *argument);

/* Initializes a condition whose timed waits go by CLOCK_MONOTONIC, so that setting the clock does not disturb
 * them. */
void cond_init_monotonic(pthread_cond_t *condition);
/* Waits for such a condition until a time (clock_now) at most. The caller holds the lock, as for
 * pthread_cond_wait, and looks at what it waits for afterwards. */
void cond_wait_until(pthread_cond_t *condition, pthread_mutex_t *lock, double until);

#endif
