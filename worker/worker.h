/* worker: the process side of rendering. Dials the master, fetches blobs, renders units on its threads and
 * sends batches; knows nothing of what a unit means (render/renderer.h does). */
#ifndef LIGHTMILL_WORKER_H
#define LIGHTMILL_WORKER_H

#include "common/health.h"
#include "proto/wire/dial.h"

#include <stdatomic.h>

enum { WORKER_DEFAULT_GRACE = 25 }; /* seconds; Docker and Kubernetes kill after 10 and 30 unless told */

typedef struct {
    void *context;                /* ZeroMQ context to share (inproc), or NULL to make one */
    const char *control_endpoint; /* "tcp://host:7420" or "inproc://name" */
    const char *bulk_endpoint;    /* NULL: the same host at the port that the master names */
    const char *cache_dir;        /* blobs by hash, shared by workers of a machine */
    uint64_t cache_limit;         /* bytes; the least recently used blobs go first */
    int threads;                  /* render threads, 0: one a core */
    const char *name;             /* NULL: host name and process id */
    bool local;                   /* inproc: payloads are not compressed */
    dial_keys_t keys;             /* kept by the caller */
    double grace;                 /* seconds for leaving in order */
    pulse_t *pulse;               /* of the control thread; kept by the caller; NULL: none */
    double patience;              /* seconds for an answer of the master, on a connection that lives */
} worker_options_t;

worker_options_t worker_options_default(void);
/* Serves until *stop becomes non-zero. 1: drains: takes no new units, finishes those that threads have begun
 * (unless the grace period does not allow it), delivers them, waits for the acknowledgement, says goodbye.
 * 2: leaves at once. Dials for ever: a master that is not there yet, or comes back, is found. Returns
 * RESULT_OK when everything that was rendered has been delivered, RESULT_UNREACHABLE when it could not be
 * within the grace period. */
result_t worker_run(const worker_options_t *options, const atomic_int *stop);

#endif
