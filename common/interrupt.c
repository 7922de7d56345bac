/* interrupt: see interrupt.h. */
#include "common/interrupt.h"

#include "common/base.h"

#include <signal.h>
#include <unistd.h>

/* How many there were; a handler can reach nothing else. */
static atomic_int interrupts;

static void on_interrupt(int number)
{
    (void)number;
    if (atomic_fetch_add(&interrupts, 1) > 0) _exit(RESULT_CANCELLED);
}

const atomic_int *interrupt_catch(void)
{
    struct sigaction action = {.sa_handler = on_interrupt, .sa_flags = SA_RESTART};
    sigemptyset(&action.sa_mask);
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    return &interrupts;
}

bool interrupt_seen(void)
{
    return atomic_load(&interrupts) > 0;
}
