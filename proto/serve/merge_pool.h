/* merge_pool: threads that decode the batches of workers and add them up, so that the thread of the bulk
 * socket never waits for it. Batches are begun in the order in which they came; several of one job are merged
 * at once.
 */
#ifndef LIGHTMILL_MERGE_POOL_H
#define LIGHTMILL_MERGE_POOL_H

#include "proto/wire/wire.h"

typedef struct merge_pool merge_pool_t;

typedef struct {
    /* What is done with a BatchResult, by several threads at once; its result is the verdict. */
    result_t (*merge)(void *context, wire_message_t *message);
    void *context; /* kept by the caller */
    int threads;   /* 0: one for each core that the process may use */
    int wake;      /* eventfd, written when a batch is done */
} merge_pool_options_t;

/* What became of a batch. */
typedef struct {
    wire_message_t *message; /* the one that was put in, the caller's again; its payloads are closed */
    uint64_t memory;         /* as it was put in */
    result_t result;
} merge_verdict_t;

result_t merge_pool_start(const merge_pool_options_t *options, merge_pool_t **pool);
/* Finishes the batches at hand, forgets those that wait, joins the threads and sets *pool to NULL. */
void merge_pool_stop(merge_pool_t **pool);

/* Takes over a message, in fresh memory, that bears a batch; `memory` is handed back with the verdict. */
void merge_pool_put(merge_pool_t *pool, wire_message_t *message, uint64_t memory);
/* The next batch that is done; false when there is none. */
bool merge_pool_next(merge_pool_t *pool, merge_verdict_t *verdict);

#endif
