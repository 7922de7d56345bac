/* worker: the process side of rendering. Dials the master, fetches blobs, renders units on its threads and
 * sends batches; knows nothing of what a unit means (render/renderer.h does). */
#ifndef LIGHTMILL_WORKER_H
#define LIGHTMILL_WORKER_H

#include "proto/link.h"

#include <stdatomic.h>

typedef struct {
    void *context;                /* ZeroMQ context to share (inproc), or NULL to make one */
    const char *control_endpoint; /* "tcp://host:7420" or "inproc://name" */
    const char *bulk_endpoint;    /* NULL: the same host at the port that the master names */
    const char *cache_dir;        /* blobs by hash, shared by workers of a machine */
    uint64_t cache_limit;         /* bytes; the least recently used blobs go first */
    int threads;                  /* render threads, 0: one a core */
    const char *name;             /* NULL: host name and process id */
    bool local;                   /* inproc: payloads are not compressed */
    link_keys_t keys;             /* kept by the caller */
} worker_options_t;

worker_options_t worker_options_default(void);
/* Serves until *stop becomes non-zero, then finishes the units in hand (1: drain: render what threads have
 * begun, send it, wait for the acknowledgement, say goodbye) or leaves at once (2). Dials for ever: a master
 * that is not there yet, or comes back, is found. Returns RESULT_OK after a clean leave. */
result_t worker_run(const worker_options_t *options, const atomic_int *stop);

#endif
