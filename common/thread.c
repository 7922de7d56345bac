/* thread: see thread.h. */
#include "common/thread.h"

#include <string.h>
#include <time.h>

result_t thread_start(pthread_t *thread, const char *name, void *(*run)(void *argument), void *argument)
{
    int error = pthread_create(thread, NULL, run, argument);
    if (error != 0) return result_fail(RESULT_LIMIT, "cannot start a thread: %s", strerror(error));
    pthread_setname_np(*thread, name);
    return result_ok();
}

void cond_init_monotonic(pthread_cond_t *condition)
{
    pthread_condattr_t attributes;
    pthread_condattr_init(&attributes);
    pthread_condattr_setclock(&attributes, CLOCK_MONOTONIC);
    pthread_cond_init(condition, &attributes);
    pthread_condattr_destroy(&attributes);
}

void cond_wait_until(pthread_cond_t *condition, pthread_mutex_t *lock, double until)
{
    struct timespec time = {.tv_sec = (time_t)until};
    time.tv_nsec = (long)(1e9 * (until - (double)time.tv_sec));
    pthread_cond_timedwait(condition, lock, &time);
}
