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

/* A terminal that is closed may say so several times. */
static void on_hangup(int number)
{
    int none = 0;
    (void)number;
    atomic_compare_exchange_strong(&interrupts, &none, 1);
}

const atomic_int *interrupt_catch(void)
{
    struct sigaction action = {.sa_handler = on_interrupt, .sa_flags = SA_RESTART}, hangup = action, was;
    sigemptyset(&action.sa_mask);
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    hangup.sa_handler = on_hangup;
    sigemptyset(&hangup.sa_mask);
    if (sigaction(SIGHUP, NULL, &was) == 0 && was.sa_handler != SIG_IGN) sigaction(SIGHUP, &hangup, NULL);
    return &interrupts;
}

bool interrupt_seen(void)
{
    return atomic_load(&interrupts) > 0;
}
