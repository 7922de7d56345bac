/* master_calls: what the HTTP server asks of the master around it. The caller of http_server_start fills in
 * the functions, so that this folder needs none of the threads behind them. */
#ifndef LIGHTMILL_HTTP_MASTER_CALLS_H
#define LIGHTMILL_HTTP_MASTER_CALLS_H

#include "master/farm/farm.h"
#include "proto/serve/gate.h"

/* Tells the outcome of a call, once, on some thread. `value` belongs to the call. */
typedef void (*http_done_fn)(void *ticket, const result_t *result, uint64_t value);

typedef struct {
    void *context; /* of the functions */
    farm_t *farm;  /* all are kept by the caller */
    gate_t *gate;  /* knows the names of keys; NULL: there are none */
    /* Carries out an order as one of `lightmill pause` is: `done` is called when it is safe on the disk, or
     * has failed. On a failure of the call itself `done` is not called. */
    result_t (*order)(void *context, const job_order_t *order, http_done_fn done, void *ticket);
    /* The path of the image of a job that is over, in fresh memory. */
    char *(*image_path)(const char *data_dir, uint64_t job);
} http_master_t;

#endif
