/* wake: see wake.h. */
#include "common/wake.h"

#include <errno.h>
#include <poll.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

result_t wake_new(int *wake)
{
    *wake = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    if (*wake >= 0) return result_ok();
    return result_fail(RESULT_LIMIT, "cannot make an eventfd: %s", strerror(errno));
}

void wake_close(int wake)
{
    if (wake >= 0) close(wake);
}

void wake_up(int wake)
{
    if (wake >= 0) eventfd_write(wake, 1); /* fails when it is full: then it is awake already */
}

void wake_wait(int wake, int milliseconds)
{
    struct pollfd wait = {.fd = wake, .events = POLLIN};
    if (poll(&wait, 1, milliseconds) > 0) wake_clear(wake);
}

void wake_clear(int wake)
{
    eventfd_t count;
    if (wake >= 0) eventfd_read(wake, &count);
}
