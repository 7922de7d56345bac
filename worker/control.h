/* control: the conversation with the master on the control socket: hello, heartbeats, asking for work,
 * leaving. */
#ifndef LIGHTMILL_CONTROL_H
#define LIGHTMILL_CONTROL_H

#include "worker/bulk.h"
#include "worker/worker.h"

typedef struct {
    const worker_options_t *options; /* all pointers are kept by the caller */
    void *context;
    workshop_t *shop;
    bulk_t *bulk;
    int wake; /* eventfd that the workshop writes to */
    const char *name;
    int threads;
} control_setup_t;

/* Runs on the calling thread until *stop asks it to leave, as worker_run says. An error only when this
 * machine cannot render the job of an inproc master, since nobody else could. */
result_t control_run(const control_setup_t *setup, const atomic_int *stop);

#endif
