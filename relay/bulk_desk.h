/* bulk_desk: the relay's bulk socket: workers offer and deliver batches and fetch scenes. */
#ifndef LIGHTMILL_BULK_DESK_H
#define LIGHTMILL_BULK_DESK_H

#include "proto/serve/gate.h"
#include "relay/desk.h"
#include "relay/pool.h"

typedef struct bulk_desk bulk_desk_t;

typedef struct {
    pool_t *pool;    /* kept by the caller */
    void *socket;    /* a bound ROUTER; closed by the desk's thread */
    gate_t *gate;    /* who may write to it; kept by the caller */
    int wake;        /* eventfd, written when batches were added or there is room again; kept by the caller */
    uint64_t credit; /* bytes that batches may take that are under way or wait to be added */
    int threads;     /* that add batches; 0: one a core */
} bulk_desk_options_t;

/* Starts the threads; on failure the socket is still the caller's. */
result_t bulk_desk_start(const bulk_desk_options_t *options, bulk_desk_t **desk);
/* Ends the threads, closes the socket and sets *desk to NULL. */
void bulk_desk_stop(bulk_desk_t **desk);

#endif
