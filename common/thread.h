/* thread: one way to start a thread. */
#ifndef LIGHTMILL_THREAD_H
#define LIGHTMILL_THREAD_H

#include "common/base.h"

#include <pthread.h>

/* Starts a thread, to be joined by the caller. `name`, at most 15 characters, is what tools show.
 * RESULT_LIMIT when the system has no thread left. */
result_t thread_start(pthread_t *thread, const char *name, void *(*run)(void *argument), void *argument);

#endif
