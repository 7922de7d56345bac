/* control: the conversation with the master on the control socket: say hello, send heartbeats, ask for work,
 * leave. */
#ifndef LIGHTMILL_CONTROL_H
#define LIGHTMILL_CONTROL_H

#include "common/health.h"
#include "proto/uplink/bulk.h"

#include <stdatomic.h>

typedef struct {
    /* All pointers are kept by the caller. */
    void *context; /* ZeroMQ context */
    uplink_handler_t handler;
    bulk_t *bulk;
    int wake;                     /* eventfd that the handler writes to */
    const char *control_endpoint; /* "tcp://host:7420" or "inproc://name" */
    const char *bulk_endpoint;    /* NULL: the same host at the port that the master names */
    const char *name;             /* for people; NULL: host name and process id */
    const char *software;         /* likewise */
    bool relay;                   /* the handler is made of workers that came over the network */
    bool local;                   /* the master is in this process: nobody else can render its job */
    double grace;                 /* seconds for leaving */
    pulse_t *pulse;               /* kept by the caller; NULL: none */
    dial_keys_t keys;             /* what they point to is kept by the caller */
} control_setup_t;

/* Runs on the calling thread until *stop asks it to leave: 1: the handler finishes what it has begun and this
 * is delivered, 2: at once. RESULT_UNREACHABLE when not all could be delivered within the grace period;
 * another error only when this machine cannot render the job of a local master. */
result_t control_run(const control_setup_t *setup, const atomic_int *stop);

#endif
